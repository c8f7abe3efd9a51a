"""SHA-256 of files, of arrays, and of what JSON can hold."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

BLOCK = 1 << 20


def file_sha256(path: str | os.PathLike[str]) -> str:
    """Of a file's bytes, as hexadecimal digits; raises OSError where they cannot be read."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()


def arrays_sha256(arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    """Of named arrays: names, dtypes, shapes and bytes."""
    digest = hashlib.sha256()
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def json_sha256(value: Any) -> str:
    """Of a value's JSON, in which the order of keys does not count."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
