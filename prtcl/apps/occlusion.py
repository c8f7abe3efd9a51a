"""`prtcl occlusion`: ambient occlusion, bent normals and visibility maps from a bake, for those who want only these."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prtcl.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from prtcl.scene.mesh import Mesh

ENDINGS = (".ply", ".npz", ".exr")
TILES = 4096
"""Visibility maps in one image at most: 64 × 64 of them, of 32 × 32 texels each at the usual 4^5 rays."""
PART = 1 << 26
"""Bytes of visibility bits held at a time, about."""


def add_parser(commands: Any) -> None:
    """Register the command."""
    occlusion = commands.add_parser(
        "occlusion", help="ambient occlusion, bent normals, visibility maps from a bake"
    )
    occlusion.add_argument("bake", metavar="BAKE", help="a bake (.npz, .zarr)")
    occlusion.add_argument(
        "-o", "--output", required=True, metavar="OUT",
        help=".ply: the mesh, occlusion as colour and as a property, bent normals as its normals; .npz: arrays; "
        ".exr: visibility maps of --vertices, tile by tile",
    )  # fmt: skip
    occlusion.add_argument(
        "--vertices", type=int, nargs="+", metavar="V", help="whose visibility maps .exr or .npz hold"
    )
    occlusion.add_argument("--quiet", action="store_true", help="no summary")
    occlusion.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read a bake part by part, and write."""
    # Late, here and below: the command line's help need not wait for NumPy and trimesh.
    import numpy as np

    from prtcl.files.atomic import check_not_input, check_writable
    from prtcl.scene.occlusion import ambient_and_bent, visibility_maps

    output, ending = options.output, Path(options.output).suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"--output {output}: expected a name that ends in {', '.join(ENDINGS)}")
    if (ending == ".exr") > bool(options.vertices) or (ending == ".ply" and options.vertices):
        raise InputError(
            f"--output {output}: "
            + ("a .ply holds no visibility maps; " if ending == ".ply" else "an .exr holds visibility maps; ")
            + ("leave out --vertices" if ending == ".ply" else "name their --vertices")
        )
    check_writable(output)
    check_not_input(output, options.bake)
    mesh, rays, parts = _open(options.bake)
    named: list[int] = options.vertices or []
    if len(named) > TILES:
        raise InputError(f"--vertices: expected at most {TILES}, got {len(named)}")
    for vertex in named:
        if not 0 <= vertex < len(mesh.vertices):
            raise InputError(f"--vertices: expected numbers from 0 to {len(mesh.vertices) - 1}, got {vertex}")
    chosen = np.array(named, dtype=np.int64)
    assert mesh.normals is not None
    ambient = np.empty(len(mesh.vertices), dtype=np.float32)
    bent = np.empty((len(mesh.vertices), 3), dtype=np.float32)
    maps = np.zeros((len(chosen), 1 << rays, 1 << rays), dtype=np.uint8)
    for start, bits in parts:
        rows = slice(start, start + len(bits))
        if ending != ".exr":
            ambient[rows], bent[rows] = ambient_and_bent(bits, rays, mesh.normals[rows])
        here = np.flatnonzero((chosen >= start) & (chosen < rows.stop))
        maps[here] = visibility_maps(bits[chosen[here] - start], rays)
    if ending == ".exr":
        _write_maps(output, maps)
    elif ending == ".ply":
        _write_ply(output, mesh, ambient, bent)
    else:
        _write_npz(output, mesh, ambient, bent, {"maps": maps, "map_vertices": chosen} if len(chosen) else {})
    if not options.quiet:
        what = f"{len(chosen)} visibility maps" if ending == ".exr" else f"{len(ambient)} vertices"
        print(f"{output}: {what}")
    return 0


def _open(path: str) -> tuple[Mesh, int, Iterator[tuple[int, npt.NDArray[np.uint32]]]]:
    """The mesh of a bake, its rays, and its bits part by part; a store is never held whole."""
    from prtcl.scene.bake import Bake, is_bake
    from prtcl.scene.bake_store import StoredBake, is_store

    if not is_bake(path):
        raise InputError(f"{path}: expected a bake, whose name ends in .npz or .zarr")
    if not is_store(path):
        bake = Bake.load(path)
        return bake.mesh, bake.rays, iter([(0, bake.bits)])
    stored = StoredBake(path)
    chunk, words = stored.store.arrays["bits"].chunks
    return stored.mesh, stored.rays, stored.parts(chunk * max(1, PART // (4 * words * chunk)))


def _write_maps(output: str, maps: npt.NDArray[np.uint8]) -> None:
    """Tiles row by row, in an image as near to square as their number allows; the rest has alpha 0."""
    import numpy as np

    from prtcl.files.image import write_exr

    across = int(np.ceil(np.sqrt(len(maps))))
    down, side = -(-len(maps) // across), maps.shape[1]
    tiles = np.zeros((down * across, side, side, 4), dtype=np.float32)
    tiles[: len(maps), ..., :3] = maps[..., None]
    tiles[: len(maps), ..., 3] = 1.0
    image = tiles.reshape(down, across, side, side, 4).swapaxes(1, 2).reshape(down * side, across * side, 4)
    write_exr(output, image, {"prtcl": f"visibility maps of {len(maps)} vertices, {side} x {side} each"})


def _write_npz(
    output: str,
    mesh: Mesh,
    ambient: npt.NDArray[np.float32],
    bent: npt.NDArray[np.float32],
    maps: dict[str, npt.NDArray[Any]],
) -> None:
    import numpy as np

    from prtcl.files.atomic import replacing

    arrays = {
        "ambient_occlusion": ambient,
        "bent_normals": bent,
        "vertices": mesh.vertices,
        "faces": mesh.faces,
    }
    with replacing(output) as aside, aside.open("wb") as file:
        np.savez_compressed(file, **arrays, **maps)  # type: ignore[arg-type]  # keywords, none allow_pickle


def _write_ply(
    output: str, mesh: Mesh, ambient: npt.NDArray[np.float32], bent: npt.NDArray[np.float32]
) -> None:
    """Binary PLY. Grey 0 … 255 is the occlusion itself: linear, as shaders multiply by it, and not sRGB."""
    import numpy as np

    from prtcl.files.atomic import replacing

    floats = ["x", "y", "z", "nx", "ny", "nz", "ambient_occlusion"]
    colours = ["red", "green", "blue"]
    vertices = np.empty(
        len(ambient), dtype=[*((name, "<f4") for name in floats), *((name, "u1") for name in colours)]
    )
    for name, column in zip(floats, [*mesh.vertices.T, *bent.T, ambient], strict=True):
        vertices[name] = column
    for name in colours:
        vertices[name] = np.rint(255.0 * ambient)
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    header = [
        "ply", "format binary_little_endian 1.0", "comment bent normals are cosine-weighted",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in floats), *(f"property uchar {name}" for name in colours),
        f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header",
    ]  # fmt: skip
    with replacing(output) as aside:
        aside.write_bytes("\n".join([*header, ""]).encode() + vertices.tobytes() + faces.tobytes())
