"""What bench/fuzz.py reads: for each reader some small valid files, made here, and what its answer must be like."""

from __future__ import annotations

import hashlib
import shutil
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mutations import mutate

HEAD = 400
"""Bytes of a file's beginning that get half of the mutations."""


@dataclass(frozen=True)
class Reader:
    """One way of reading.

    Attributes
    ----------
    share : inputs of 1000
    make : writes the valid files into a folder and returns them
    spoil : (folder, bases, rng) writes one input and returns its path
    read : reads a path and checks what it got; AssertionError is a finding
    valid : whether `read` takes the files of `make`
    """

    share: int
    make: Callable[[Path], list[Path]]
    spoil: Callable[[Path, list[Path], np.random.Generator], Path]
    read: Callable[[Path], None]
    valid: bool = True


def spoil_file(folder: Path, bases: list[Path], rng: np.random.Generator) -> Path:
    """Mutated bytes of one of the files."""
    base, other = (bases[int(rng.integers(len(bases)))] for _ in range(2))
    path = folder / f"input{base.suffix}"
    path.write_bytes(mutate(base.read_bytes(), rng, HEAD, other.read_bytes()))
    return path


def spoil_member(folder: Path, bases: list[Path], rng: np.random.Generator) -> Path:
    """A whole archive of which one array is mutated: the archive's own checksum would hide it from the reader."""
    with zipfile.ZipFile(bases[int(rng.integers(len(bases)))]) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    names = list(members)
    chosen, other = (names[int(rng.integers(len(names)))] for _ in range(2))
    members[chosen] = mutate(members[chosen], rng, 128, members[other])
    if rng.random() < 0.1:
        members[chosen] = members[other]
    if rng.random() < 0.05:
        del members[chosen]
    path = folder / "input.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def spoil_store(folder: Path, bases: list[Path], rng: np.random.Generator) -> Path:
    """A store of which one file is mutated; mostly the list of hashes is made to fit, so that Zarr reads it."""
    path = bases[0]
    whole = {
        item: item.read_bytes() for item in sorted(path.parent.joinpath("whole").rglob("*")) if item.is_file()
    }
    files = {path / item.relative_to(path.parent / "whole"): data for item, data in whole.items()}
    names = [item for item in files if item.name == "zarr.json" or rng.random() < 0.1]
    chosen = names[int(rng.integers(len(names)))]
    files[chosen] = mutate(files[chosen], rng, HEAD, files[names[int(rng.integers(len(names)))]])
    for item, data in files.items():
        if not item.is_file() or item.read_bytes() != data:
            item.write_bytes(data)
    sums = path / "SHA256SUMS"
    if chosen != sums and rng.random() < 0.9:
        listed = [item for item in files if item != sums]
        lines = "".join(
            f"{hashlib.sha256(files[item]).hexdigest()}  {item.relative_to(path).as_posix()}\n"
            for item in listed
        )
        sums.write_text(f"{lines}# {hashlib.sha256(lines.encode()).hexdigest()}\n")
    return path


# --- images ------------------------------------------------------------------------------------------------


def make_exr(folder: Path) -> list[Path]:
    """Every compression, half and float, scanlines and tiles, a grey one, two parts."""
    import OpenEXR

    rng, found = np.random.default_rng(1), []

    def write(name: str, header: dict[str, Any], channels: dict[str, Any]) -> None:
        found.append(folder / f"{name}.exr")
        OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels).write(str(found[-1]))

    colour = rng.uniform(0, 3, (12, 20, 3)).astype(np.float32)
    for name in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"):
        dtype = np.float16 if name[0] in "BD" else np.float32
        write(name, {"compression": getattr(OpenEXR, f"{name}_COMPRESSION")}, {"RGB": colour.astype(dtype)})
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 8
    write("tiled", {"type": OpenEXR.tiledimage, "tiles": tiles, "compression": OpenEXR.ZIP_COMPRESSION},
          {"RGB": colour})  # fmt: skip
    write("grey", {"compression": OpenEXR.ZIPS_COMPRESSION}, {"Y": colour[..., 0].copy()})
    return found


def make_hdr(folder: Path) -> list[Path]:
    """Run-length encoded, and flat, as old programs wrote it."""
    rng = np.random.default_rng(2)
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.0\n\n"
    flat = rng.integers(1, 200, (6, 4, 4), dtype=np.uint8)
    flat[..., 3] = 128
    coded = b""
    for _ in range(8):
        coded += b"\2\2" + struct.pack(">H", 16)
        for channel in range(4):
            own = bytes(rng.integers(1, 200, 8, dtype=np.uint8)) if channel < 3 else b"\x80" * 8
            coded += b"\x08" + own + bytes([128 + 8, int(own[0])])
    paths = [folder / "flat.hdr", folder / "coded.hdr"]
    paths[0].write_bytes(head + b"-Y 6 +X 4\n" + flat.tobytes())
    paths[1].write_bytes(head + b"-Y 8 +X 16\n" + coded)
    return paths


def read_image(path: Path) -> None:
    from prtcl.files.radiance import read_radiance

    image, _ = read_radiance(path)
    assert image.dtype == np.float32 and image.ndim == 3 and image.shape[2] == 3 and image.size
    assert np.isfinite(image).all() and image.min() >= 0.0, "values that it promises to refuse"


# --- reflectances ------------------------------------------------------------------------------------------


def make_merl_head(folder: Path) -> list[Path]:
    """The header and some numbers; only its length is wrong, so that every answer is a refusal."""
    path = folder / "a.binary"
    path.write_bytes(struct.pack("<3i", 90, 90, 180) + np.linspace(0, 1, 32).tobytes())
    return [path]


def make_merl(folder: Path) -> list[Path]:
    path = folder / "whole.binary"
    values = np.random.default_rng(3).uniform(-0.1, 1.0, 3 * 90 * 90 * 180)
    path.write_bytes(struct.pack("<3i", 90, 90, 180) + values.tobytes())
    return [path]


def read_merl(path: Path) -> None:
    from prtcl.files.merl import read_merl as read

    values, valid = read(path)
    assert values.shape == (90, 90, 180, 3) and valid.shape == (90, 90, 180) and np.isfinite(values).all()


def make_utia(folder: Path) -> list[Path]:
    path = folder / "a.bin"
    path.write_bytes(np.random.default_rng(4).uniform(0, 1, 3 * 288 * 288).tobytes())
    return [path]


def read_utia(path: Path) -> None:
    from prtcl.files.utia import read_utia as read

    values = read(path)
    assert values.shape == (6, 48, 6, 48, 3) and np.isfinite(values).all()


TENSOR_TYPES = {"u1": 1, "f4": 10}


def make_rgl(folder: Path) -> list[Path]:
    """One azimuth and two, rgb and spectra: tables as small as the reader takes."""
    rng, paths = np.random.default_rng(5), []
    for name, phis, colours, waves in (
        ("iso", 1, "rgb", 3),
        ("two azimuths", 2, "rgb", 3),
        ("spectra", 1, "spectra", 8),
    ):
        fields: dict[str, Any] = {
            "theta_i": np.linspace(0, 1.5, 4), "phi_i": np.linspace(-3, 3, phis) if phis > 1 else np.zeros(1),
            "ndf": rng.uniform(0.1, 1, (4, 6)), "sigma": rng.uniform(0.1, 1, (2, 6)),
            "vndf": rng.uniform(0.1, 1, (phis, 4, 4, 6)), "luminance": rng.uniform(0.1, 1, (phis, 4, 4, 4)),
            colours: rng.uniform(0.1, 1, (phis, 4, waves, 4, 4)),
        }  # fmt: skip
        if colours == "spectra":
            fields["wavelengths"] = np.linspace(400.0, 700.0, waves)
        arrays = {key: value.astype("<f4") for key, value in fields.items()}
        arrays |= {"jacobian": np.ones(1, np.uint8), "description": np.frombuffer(b"made", np.uint8)}
        paths.append(folder / f"{name}.bsdf")
        paths[-1].write_bytes(tensors(arrays))
    return paths


def tensors(arrays: dict[str, Any]) -> bytes:
    """The container as prtcl.files.tensor_file describes it."""
    at, index, body = 18 + sum(13 + len(key) + 8 * array.ndim for key, array in arrays.items()), b"", b""
    for key, array in arrays.items():
        index += struct.pack(f"<H{len(key)}sHBQ", len(key), key.encode(), array.ndim,
                             TENSOR_TYPES[array.dtype.str[1:]], at + len(body))  # fmt: skip
        index += struct.pack(f"<{array.ndim}Q", *array.shape)
        body += array.tobytes()
    return b"tensor_file\0\1\0" + struct.pack("<I", len(arrays)) + index + body


def read_rgl(path: Path) -> None:
    from prtcl.files.rgl import read_rgl as read

    assert all(
        np.isfinite(array).all() for array in vars(read(path)).values() if isinstance(array, np.ndarray)
    )


def make_table(folder: Path) -> list[Path]:
    from prtcl.factors.bivariate import Bivariate

    values = np.random.default_rng(6).uniform(0.1, 1, (5, 4, 3))
    valid = np.ones((5, 4), dtype=bool)
    path = folder / "table.npz"
    Bivariate.make(values, np.linspace(0, 1.5, 5), np.linspace(0, 1.5, 4), valid).save(path)
    return [path]


def read_table(path: Path) -> None:
    from prtcl.factors.bivariate import Bivariate

    table = Bivariate.load(path)
    assert (
        np.isfinite(table.values).all()
        and np.isfinite(table.theta_h).all()
        and np.isfinite(table.theta_d).all()
    )


# --- bakes -------------------------------------------------------------------------------------------------


def _bake() -> Any:
    from dataclasses import replace

    from prtcl.scene.bake import Bake
    from prtcl.scene.mesh import Mesh, PartMaterial
    from prtcl.scene.texture import Texture

    rng = np.random.default_rng(7)
    corners = rng.permuted(np.tile(np.arange(9), (6, 1)), axis=1)[:, :3]
    mesh = Mesh.from_arrays(rng.normal(size=(9, 3)), corners, rng.normal(size=(9, 3)), "m",
                            rng.uniform(size=(9, 3)), rng.uniform(size=(9, 2)))  # fmt: skip
    texture = Texture(rng.integers(0, 256, (2, 3, 3), dtype=np.uint8))
    mesh = replace(mesh, materials=(PartMaterial("", (0.5, 0.5, 0.5), 0.0, 1.0, texture),))
    return Bake(mesh, rng.integers(0, 2**32, (9, 2), dtype=np.uint32), 3)


def make_bake(folder: Path) -> list[Path]:
    _bake().save(folder / "bake.npz")
    return [folder / "bake.npz"]


def make_store(folder: Path) -> list[Path]:
    _bake().save(folder / "bake.zarr")
    shutil.copytree(folder / "bake.zarr", folder / "whole")
    return [folder / "bake.zarr"]


def read_bake(path: Path) -> None:
    from prtcl.scene.bake import Bake

    bake = Bake.load(path)
    mesh = bake.mesh
    assert mesh.normals is not None and len(bake.bits) == len(mesh.vertices) == len(mesh.normals)
    assert bake.bits.shape[1] == max(1, 4**bake.rays // 32) and np.isfinite(mesh.vertices).all()
    assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
    assert 0 <= mesh.parts.min() <= mesh.parts.max() < len(mesh.materials)
    mesh.vertex_colour(np.arange(len(mesh.vertices)))


READERS = {
    "exr": Reader(260, make_exr, spoil_file, read_image),
    "hdr": Reader(180, make_hdr, spoil_file, read_image),
    "merl": Reader(98, make_merl_head, spoil_file, read_merl, valid=False),
    "merl whole": Reader(2, make_merl, spoil_file, read_merl),
    "utia": Reader(20, make_utia, spoil_file, read_utia),
    "rgl": Reader(160, make_rgl, spoil_file, read_rgl),
    "table": Reader(60, make_table, spoil_file, read_table),
    "table arrays": Reader(60, make_table, spoil_member, read_table),
    "bake .npz": Reader(50, make_bake, spoil_file, read_bake),
    "bake .npz arrays": Reader(70, make_bake, spoil_member, read_bake),
    "bake .zarr": Reader(40, make_store, spoil_store, read_bake),
}
"""Shares follow from how much there is to go wrong, and how long a reading takes."""
