"""Code that a server of `benchmarks.strangers` runs: what no stranger's file may cause."""

import importlib
import os
import pickle
import signal
import socket
import subprocess
from pathlib import Path

MODULES = {module.__name__: module for module in (importlib, os, pickle, signal, socket, subprocess)}


def run(words: list[str]) -> object:
    """Run code; return its `status`."""
    names: dict[str, object] = {**MODULES, "Path": Path, "status": 0}
    exec(words[0], names)
    return names["status"]
