"""Errors of downloads."""

from __future__ import annotations

import errno

from tdgbench.scenes.errors import SceneError

_FULL = (errno.ENOSPC, errno.EDQUOT)


class GetError(SceneError):
    """A data set cannot be fetched. The message names the file or the address, and the remedy."""


class BadFileError(GetError):
    """One file cannot be used; the others can still be fetched."""


def is_full(error: OSError) -> bool:
    """Whether an error says that a disk is full.

    >>> is_full(OSError(errno.ENOSPC, "No space left on device"))
    True
    """
    return error.errno in _FULL
