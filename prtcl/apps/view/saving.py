"""What a page saves: into one folder, under names this program makes, over nothing that is there."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

from prtcl.apps.view.look import Look
from prtcl.apps.view.state import State
from prtcl.errors import InputError
from prtcl.factors.material import Material
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


def save_material(folder: Path, state: State, parts: tuple[str, ...]) -> list[Path]:
    """Write the looks of all parts, and the light they were judged under, as JSON, and beside it tables as .npz.

    Returns their paths, the JSON's first.
    """
    tables = {number: look.recipe for number, look in enumerate(state.looks, 1) if look.kind == "table"}
    suffixes = (".json", *(f"-part{number}.npz" for number in tables))
    with reserved(folder, "material", suffixes) as paths:
        names = dict(zip(tables, (path.name for path in paths[1:]), strict=True))
        for recipe, path in zip(tables.values(), paths[1:], strict=True):
            assert recipe is not None
            recipe.table.save(path)
        with replacing(paths[0]) as aside:
            text = json.dumps(described(state, parts, names), indent=2)
            aside.write_text(text + "\n", encoding="utf-8")
    return paths


def described(state: State, parts: tuple[str, ...], tables: dict[int, str] | None = None) -> dict[str, Any]:
    """What is saved of a state: SPECs are as `--brdf` takes them.

    Parameters
    ----------
    tables : numbers of the parts that wear one, from 1, to the names of their files
    """
    materials = []
    for number, (part, look) in enumerate(zip(parts, state.looks, strict=True), 1):
        if number in (tables or {}):
            file = (tables or {})[number]
            materials.append({"part": part, "brdf": f"table:{file}", "edits": edits(look)})
        else:
            materials.append({"part": part, "brdf": look.spec})
    return {
        "materials": materials,
        "environment": state.environment,
        "rotate": state.rotate,
        "exposure": state.exposure,
    }


def edits(look: Look) -> dict[str, Any]:
    """What was done to a table, as the page's numbers."""
    if look.recipe is None:
        return {}
    numbers = {f.name: getattr(look.recipe, f.name) for f in fields(look.recipe)}
    return {name: value.spec if isinstance(value, Material) else value for name, value in numbers.items()}


def _remove(paths: list[Path]) -> None:
    for path in paths:
        with suppress(OSError):
            path.unlink()
    paths.clear()
