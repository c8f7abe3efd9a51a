"""Reads the materials of Wavefront .mtl libraries: metallic-roughness factors, and the image of map_Kd."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from prtcl.scene.mesh_raw import PartMaterial
from prtcl.scene.texture import Texture, beside_by_name, decode_image, unread

# How many words follow an option of a map in an .mtl; the three that say where the image lies take one to three.
_OPTION_WORDS = {"-mm": 2, "-o": 3, "-s": 3, "-t": 3}
_OTHER_MAPS = ("bump", "disp", "decal", "refl", "norm")  # that do not begin with map_


def materials_of(
    path: Path, libraries: list[str], used: set[str], notes: list[str]
) -> dict[str, PartMaterial]:
    """Read the materials that are used from those libraries that exist."""
    found: dict[str, PartMaterial] = {}
    textures: dict[tuple[Path, str], Texture | Exception] = {}
    for library in dict.fromkeys(libraries):
        try:
            text = (path.parent / library).read_text(encoding="utf-8", errors="replace")
        except (OSError, ValueError):
            notes.append(f"material library '{library}' is not there or cannot be read")
            continue
        entries: dict[str, dict[str, list[str]]] = {}
        for _, line in joined_lines(text):
            words = line.split()
            if len(words) < 2:
                continue
            if words[0] == "newmtl":
                entry = entries.setdefault(line[6:].strip(), {})
            elif entries:
                entry[words[0]] = words[1:]
        folder = (path.parent / library).parent
        for name, entry in entries.items():
            if name in used and name not in found:
                found[name] = _material(name, entry, _texture(name, entry, folder, textures, notes))
    return found


def _texture(
    name: str,
    entry: dict[str, list[str]],
    folder: Path,
    known: dict[tuple[Path, str], Texture | Exception],
    notes: list[str],
) -> Texture | None:
    """Read the image of map_Kd, once for all materials that name it; note what is left out."""
    left_out = [key for key in entry if key.startswith("map_") or key.lower() in _OTHER_MAPS]
    words = entry.get("map_Kd")
    if words is not None:
        left_out.remove("map_Kd")
    if left_out:
        notes.append(f"material '{name}': not read: {', '.join(left_out)}")
    if words is None:
        return None
    options, file = _options(words)
    if options:
        notes.append(f"material '{name}': the options of map_Kd are not read: {options}")
    key = (folder, file)
    if key not in known:
        try:
            known[key] = Texture(decode_image(beside_by_name(folder, file)))
        except Exception as error:  # whatever is wrong with an image, the geometry is good
            known[key] = error
    texture = known[key]
    if isinstance(texture, Exception):
        notes.append(unread(f"material '{name}': ", file, texture))
        return None
    return texture


def _options(words: list[str]) -> tuple[str, str]:
    """Part the words of a map into its options and the file name, which may have spaces."""
    at = 0
    while words[at].startswith("-") and at + 2 < len(words):
        last = min(at + _OPTION_WORDS.get(words[at], 1), len(words) - 2)
        at += 2
        # Numbers that may be left out end where something else begins.
        while at <= last and _is_number(words[at]):
            at += 1
    return " ".join(words[:at]), " ".join(words[at:])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _material(name: str, entry: dict[str, list[str]], texture: Texture | None) -> PartMaterial:
    """Map an MTL entry to metallic-roughness: Kd, Pm and Pr, or roughness from the exponent Ns."""
    try:
        red, green, blue = (min(max(float(word), 0.0), 1.0) for word in (entry.get("Kd", []) * 3)[:3])
    except ValueError:
        # The format's usual default, also for spectral colours; a texture alone says what colour it is.
        red = green = blue = 0.8 if texture is None else 1.0
    exponent = _number(entry, "Ns", 0.0)
    # alpha = sqrt(2 / (Ns + 2)) matches the width of a Blinn-Phong lobe, and alpha = roughness squared.
    roughness = min(max(_number(entry, "Pr", (2.0 / (max(exponent, 0.0) + 2.0)) ** 0.25), 0.0), 1.0)
    return PartMaterial(name, (red, green, blue), _number(entry, "Pm", 0.0), roughness, texture)


def _number(entry: dict[str, list[str]], key: str, default: float) -> float:
    """Return the first number of a key, or the default."""
    try:
        value = float(entry[key][0])
    except (KeyError, IndexError, ValueError):
        return default
    return value if np.isfinite(value) else default


def joined_lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield numbered lines without comments, those ending in a backslash joined with the next."""
    held = ""
    for number, line in enumerate(text.split("\n"), start=1):
        line = held + line.split("#", 1)[0].strip()
        held = ""
        if line.endswith("\\"):
            held = line[:-1] + " "
            continue
        yield number, line
    if held:
        yield number, held
