"""What a page saves: into one folder, under names this program makes, over nothing that is there."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from prtcl.apps.view.state import State
from prtcl.errors import InputError
from prtcl.files.atomic import replacing
from prtcl.scene.scene import Render

MOST = 999
"""Files of a kind in the folder: a page that saves and saves does not fill the disk."""


@contextmanager
def reserved(folder: Path, stem: str, suffixes: tuple[str, ...]) -> Iterator[list[Path]]:
    """Yield paths `stem`-NNN, one for each suffix, that are free and, made here, stay so; gone if the block fails."""
    taken: list[Path] = []
    for number in range(1, MOST + 1):
        try:
            for suffix in suffixes:
                path = folder / f"{stem}-{number:03d}{suffix}"
                # Fails on whatever is there, a dangling link too.
                os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
                taken.append(path)
            break
        except FileExistsError:
            _remove(taken)
        except OSError as error:
            _remove(taken)
            raise InputError(f"{folder}: cannot be written: {error}") from error
    else:
        raise InputError(f"{folder}: holds {MOST} files {stem}-NNN{suffixes[0]}; move them away")
    try:
        yield list(taken)
    except BaseException:
        _remove(taken)
        raise


def save_image(folder: Path, render: Render, exposure: float) -> list[Path]:
    """Write an EXR and an sRGB PNG; returns their paths."""
    with reserved(folder, "view", (".exr", ".png")) as (exr, png):
        render.save(exr, png=png, exposure=exposure)
    return [exr, png]


def save_material(folder: Path, state: State, parts: tuple[str, ...]) -> Path:
    """Write the looks of all parts, and the light they were judged under, as JSON; returns its path."""
    with reserved(folder, "material", (".json",)) as (path,), replacing(path) as aside:
        aside.write_text(json.dumps(described(state, parts), indent=2) + "\n", encoding="utf-8")
    return path


def described(state: State, parts: tuple[str, ...]) -> dict[str, Any]:
    """What is saved of a state: SPECs are as `--brdf` takes them."""
    return {
        "materials": [
            {"part": part, "brdf": look.spec} for part, look in zip(parts, state.looks, strict=True)
        ],
        "environment": state.environment,
        "rotate": state.rotate,
        "exposure": state.exposure,
    }


def _remove(paths: list[Path]) -> None:
    for path in paths:
        with suppress(OSError):
            path.unlink()
    paths.clear()
