"""Read what `torch.save` wrote as data: tensors and plain values, in no more memory than the file has bytes.

`weights_only=True` runs no code, but unpacks compressed members, calls what takes memory for a number (bytearray), and
gives tensors of any size on a storage of one byte. So the archive and its pickle are checked before, tensors after.
"""

from __future__ import annotations

import pickletools
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import torch

from tdgbench.files import MB, in_mb, opened

MOST_PICKLE = 16 * MB  # of the names and shapes of a file's tensors
NAMED = ("collections OrderedDict", "torch._utils _rebuild_tensor_v2", "torch._utils _rebuild_parameter")
OF_OTHERS = ("STACK_GLOBAL", "INST", "OBJ", "NEWOBJ", "NEWOBJ_EX", "EXT1", "EXT2", "EXT4")  # torch writes none of these
PLAIN = (str, int, float, bool, type(None))


def load_tensors(path: Path, inside: Path | None = None, mapped: bool = False) -> Any:
    """Read a file of `torch.save`. inside: folder that it must lie in. mapped: whether tensors stay on the disk.

    Raises ValueError, which says why and names no file, for anything else than plain values and dense tensors, and
    FileNotFoundError where there is nothing.
    """
    with opened(path, inside=inside) as file:
        size = _checked_size(file)
        file.seek(0)
        try:
            where: dict[str, Any] = {"map_location": "cpu", "weights_only": True}
            content = torch.load(path, mmap=True, **where) if mapped else torch.load(file, **where)
        except Exception as error:  # torch documents no types, and its messages advise to trust the file
            raise ValueError(f"it cannot be read ({type(error).__name__})") from error
    _check_values(content, size)
    return content


def _checked_size(file: BinaryIO) -> int:
    """Return the size of a file. Raises ValueError unless it is an archive of torch that holds no more than that."""
    size = file.seek(0, 2)
    try:
        with zipfile.ZipFile(file) as archive:
            pickled = archive.read(_checked_pickle(archive.infolist(), size))
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise ValueError(f"it is no file of torch.save, or damaged: {error}") from error
    for opcode, argument, _ in pickletools.genops(pickled):
        named = str(argument)
        is_storage = named.startswith("torch ") and named.endswith("Storage")
        if opcode.name == "GLOBAL" and not is_storage and named not in NAMED:
            raise ValueError(f"it names {named.replace(' ', '.')}, which is neither a tensor nor a plain value")
        if opcode.name in OF_OTHERS:
            raise ValueError(f"it is not written by torch.save ({opcode.name})")
    return size


def _checked_pickle(members: list[zipfile.ZipInfo], size: int) -> zipfile.ZipInfo:
    """Return the member of an archive of `size` bytes that names its tensors. Raises ValueError for other archives."""
    if any(member.compress_type != zipfile.ZIP_STORED for member in members):
        raise ValueError("it is compressed, as torch compresses nothing")
    if sum(member.file_size for member in members) > size:
        raise ValueError(f"it states more than its {in_mb(size)}")
    pickles = [member for member in members if member.filename.rsplit("/", 1)[-1] == "data.pkl"]
    if len(pickles) != 1 or pickles[0].file_size > MOST_PICKLE:
        raise ValueError("it is no file of torch.save")
    return pickles[0]


def _check_values(content: Any, size: int) -> None:
    """Raise ValueError for other values than plain ones and dense tensors, and for tensors larger than the file."""
    todo, known, total = [content], set[int](), 0
    while todo:
        value = todo.pop()
        if id(value) in known or isinstance(value, PLAIN):
            continue
        known.add(id(value))
        if isinstance(value, torch.Tensor):
            if value.layout != torch.strided or value.is_quantized:
                raise ValueError("it holds a tensor that is not dense")
            total += value.numel() * value.element_size()
        elif isinstance(value, dict):
            todo += [*value.keys(), *value.values()]
        elif isinstance(value, list | tuple):
            todo += value
        else:
            raise ValueError(f"it holds {type(value).__name__}, which is neither a tensor nor a plain value")
    if total > size:
        raise ValueError(f"its tensors have {in_mb(total)}, and it has {in_mb(size)}")
