"""Folders of the checkout, and files that only some checkouts have beside them."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared" / "data"  # real data, which a clone does not have


def lpips_backbone(name: str) -> Path:
    """A backbone among the shared files; without it, the test is skipped."""
    file = SHARED / name
    if not file.exists():
        pytest.skip(f"the LPIPS backbone is not at {file}")
    return file
