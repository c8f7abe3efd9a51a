"""Reads the arrays of a NumPy .npz file, whatever may be wrong with it."""

from __future__ import annotations

import os
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError


def read_npz(path: str | os.PathLike[str], what: str) -> dict[str, NDArray[Any]]:
    """Every array of an .npz, by name; nothing is unpickled.

    Parameters
    ----------
    path : str or os.PathLike
        The file.
    what : str
        What it should be, such as "a bake made by `prtcl bake`"; it goes into the messages.

    Raises
    ------
    InputError
        The file is missing, a folder, no .npz, truncated or damaged, or holds Python objects.
    """
    source = Path(path)
    try:
        if source.is_dir():
            raise InputError(f"{source}: expected {what}, got a folder; name a file inside it")
        with source.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise InputError(
                    f"{source}: expected {what}, got something that is no .npz, or one that is cut off; "
                    "copy or make it again"
                )
            stream.seek(0)
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # NumPy warns of a header it has to guess at
                with np.load(stream, allow_pickle=False) as file:
                    return {key: np.asarray(file[key]) for key in file.files}
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(f"{source}: no such file; expected {what}") from error
    except Exception as error:
        # A damaged archive raises BadZipFile, zlib.error, NotImplementedError, RuntimeError, MemoryError, …
        reason = (str(error).strip() or type(error).__name__).splitlines()[0][:160]
        raise InputError(
            f"{source}: cannot be read as {what}, it is damaged or something else ({reason}); "
            "copy or make it again"
        ) from error
