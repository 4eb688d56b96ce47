"""No test of downloads talks to the internet."""

from __future__ import annotations

import socket

import pytest


@pytest.fixture(autouse=True)
def only_this_machine(monkeypatch):
    """Names other than that of this machine have no address, and proxies are not used."""
    real = socket.getaddrinfo

    def addresses(host, *arguments, **keywords):
        if host not in ("127.0.0.1", "localhost"):
            raise socket.gaierror(socket.EAI_NONAME, f"a test asks for {host}")
        return real(host, *arguments, **keywords)

    monkeypatch.setattr(socket, "getaddrinfo", addresses)
    monkeypatch.setenv("NO_PROXY", "*")
