"""What a batch is made of: files found, names given, and a fingerprint of everything that its images depend on."""

from __future__ import annotations

import dataclasses
import glob
import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from prtcl.errors import InputError
from prtcl.factors.material import Material
from prtcl.files.digest import file_sha256
from prtcl.files.radiance import EXTENSIONS
from prtcl.files.source import check_source
from prtcl.scene.mesh import Mesh


def environments(given: Sequence[str]) -> list[Path]:
    """Environment files, in the order given; those of a folder or a glob by name. Each file once.

    Raises
    ------
    InputError
        If a file is not there or no map, a folder holds none, or a glob matches none.
    """
    found: list[Path] = []
    for text in given:
        path = Path(text)
        if path.is_dir():
            inside = sorted(filter(_is_map, path.iterdir()))
            if not inside:
                raise InputError(f"--env {text}: there is no {', '.join(EXTENSIONS)} in this folder")
            found += inside
        elif glob.has_magic(text) and not path.exists():
            matches = sorted(Path(name) for name in glob.glob(text, recursive=True))
            maps = list(filter(_is_map, matches))
            if not maps:
                raise InputError(
                    f"--env {text}: expected environment maps ({', '.join(EXTENSIONS)}), no file matches\n"
                    "check the pattern, and the folder that it starts from"
                )
            found += maps
        else:
            found.append(check_source(path, EXTENSIONS, "an environment map"))
    once: dict[str, Path] = {}
    for path in found:
        once.setdefault(os.path.realpath(path), path)
    return list(once.values())


def _is_map(path: Path) -> bool:
    """By its name. What macOS keeps beside a file on other disks, ._sky.exr, is none."""
    return path.suffix.lower() in EXTENSIONS and not path.name.startswith(".") and path.is_file()


def file_digest(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        return file_sha256(path)
    except OSError as error:
        raise InputError(f"{os.fspath(path)}: cannot be read: {error.strerror}") from error


def mesh_digest(mesh: Mesh, *more: Any) -> str:
    """SHA-256 of all that a mesh's images depend on, whatever files it came from; `more` is a bake's."""
    skipped = ("name", "notes", "twins")
    fields = [getattr(mesh, f.name) for f in dataclasses.fields(mesh) if f.name not in skipped]
    return digest([*fields, *more])


def material_digest(material: Material | None) -> str:
    """SHA-256 of a material's numbers and tables, whatever files they came from; None is the mesh's own."""
    if material is None:
        return "own"
    return digest([material.kind, material.numbers, material.table, material.tints])


def digest(value: Any) -> str:
    """SHA-256 of plain values, arrays, dataclasses and containers of such."""
    total = hashlib.sha256()
    for piece in _pieces(value):
        total.update(len(piece).to_bytes(8, "little"))
        total.update(piece)
    return total.hexdigest()


def _pieces(value: Any) -> Iterable[bytes]:
    if isinstance(value, np.ndarray):
        yield f"{value.dtype.str} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield type(value).__name__.encode()
        for field in dataclasses.fields(value):
            yield from _pieces(getattr(value, field.name))
    elif isinstance(value, dict):
        yield f"dict {len(value)}".encode()
        for key in sorted(value):
            yield str(key).encode()
            yield from _pieces(value[key])
    elif isinstance(value, list | tuple):
        yield f"list {len(value)}".encode()
        for item in value:
            yield from _pieces(item)
    elif isinstance(value, np.generic):
        yield repr(value.item()).encode()
    elif value is None or isinstance(value, str | int | float | bool):
        yield repr(value).encode()
    else:
        raise TypeError(f"no fingerprint of {type(value).__name__} is known")


def as_json(value: Any) -> Any:
    """What a value is once it has been written as JSON and read again, to compare with what was."""
    return json.loads(json.dumps(value))
