"""Ambient occlusion, bent normals and visibility maps, against float64 from the definition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl import quadtree
from prtcl.apps import cli
from prtcl.factors import hemisphere
from prtcl.scene import occlusion
from prtcl.scene.bake import Bake
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.occlusion import ambient_and_bent, ambient_occlusion, sums, unpack, visibility_maps

U32 = 2.0**-24
"""Unit roundoff of float32: of the stored table of directions and of the results."""


def packed(visible: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Bits of (n, 4**rays) samples, one by one from the definition."""
    words = max(1, visible.shape[1] // 32)
    bits = np.zeros((len(visible), words), dtype=np.uint32)
    for point, sample in zip(*np.nonzero(visible), strict=True):
        bits[point, sample // 32] |= np.uint32(1 << (sample % 32))
    return bits


def unit(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    normals = rng.normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def plane() -> Mesh:
    """A square of two triangles at z = 0, all of whose vertices see the whole sky."""
    return Mesh.from_arrays([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("rays", [1, 2, 3, 5])
def test_a_plane_is_open_and_its_bent_normal_its_normal(rays: int) -> None:
    bake = Bake.trace(plane(), rays)
    assert bake.mesh.normals is not None
    ambient, bent = ambient_and_bent(bake.bits, rays, bake.mesh.normals)
    assert (ambient == 1.0).all()
    assert np.abs(bent - [0.0, 0.0, 1.0]).max() < 4 * U32


@pytest.mark.parametrize("rays", [1, 2, 4])
def test_under_a_lid_nothing_is_seen(rays: int) -> None:
    normals = unit(np.random.default_rng(1), 3)
    bits = np.zeros((3, quadtree.visibility_words(rays)), dtype=np.uint32)
    ambient, bent = ambient_and_bent(bits, rays, normals)
    assert (ambient == 0.0).all() and (bent == 0.0).all()


@pytest.mark.parametrize("rays", [1, 2, 3, 5, 6])
def test_half_a_sky_is_half(rays: int) -> None:
    """A wall through the normal hides half of the cells exactly, mean cosines and all."""
    _, columns = quadtree.morton_to_grid(rays)
    bits = packed((columns >= (1 << rays) // 2)[None])
    ambient, local = sums(bits, rays)
    assert abs(ambient[0] - 0.5) < U32
    # ∫ x cos θ dω / π over the half with x > 0 is 2/3 of that over z, 2/3 · 1/2 = 1/3 … over cells, as they are.
    cells = hemisphere.directions(rays).astype(np.float64)
    seen = columns >= (1 << rays) // 2
    wanted = (cells[seen, 3:] * cells[seen, :3]).sum(axis=0) / cells[:, 3].sum()
    assert np.abs(local[0] - wanted).max() < 1e-14 * 4**rays
    assert local[0, 0] > 0.2 and abs(local[0, 1]) < U32


@pytest.mark.parametrize("rays", [1, 2, 3, 5])
def test_sums_equal_those_of_the_definition(rays: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(rays)
    visible = rng.uniform(size=(37, 4**rays)) < rng.uniform(size=(37, 1))
    bits, normals = packed(visible), unit(rng, 37)
    assert (unpack(bits, rays) == visible).all()
    rows, columns = quadtree.morton_to_grid(rays)
    side = 1 << rays
    centres = hemisphere.from_square((columns + 0.5) / side, (rows + 0.5) / side)
    cosines = hemisphere.mean_cosines(rows, columns, side)
    assert abs(cosines.sum() - side**2 / 2) < 1e-12 * side**2
    wanted = np.array([cosines[seen].sum() / (side**2 / 2) for seen in visible])
    frames = hemisphere.frames_from(normals).astype(np.float64)
    world = np.array([
        sum((cosines[s] * (centres[s] @ frame) for s in np.flatnonzero(seen)), np.zeros(3))
        for seen, frame in zip(visible, frames, strict=True)
    ])  # fmt: skip
    length = np.linalg.norm(world, axis=1, keepdims=True)
    monkeypatch.setattr(occlusion, "BYTES", 8 * 4**rays * 5)  # parts of 5 vertices, and a last one of 2
    ambient, bent = ambient_and_bent(bits, rays, normals)
    assert ambient.dtype == bent.dtype == np.float32
    # The table and the result are float32; sums are float64.
    assert np.abs(ambient - wanted).max() < 4 * U32
    assert (ambient_occlusion(bits, rays) == ambient).all()
    seen = length[:, 0] > 0
    # Directions and cosines differ by a few roundings, relative to the sum of what is visible: that is length or more.
    bound = 8 * U32 * (wanted * side**2 / 2)[seen, None] / length[seen]
    assert (np.abs(bent - world / np.where(length > 0, length, 1.0))[seen] < bound).all()
    assert np.abs(np.linalg.norm(bent[seen], axis=1) - 1.0).max() < 4 * U32


def test_inside_a_box_with_its_lid_open() -> None:
    """The middle of its bottom sees the opening as a form factor known in closed form.

    For half width and depth of 1 that is four quarters, each 1/(2π) · 2/√2 · atan(1/√2) (Howell, catalogue of
    configuration factors, B-3): 0.5541.
    """
    w = h = 1.0
    floor = [[x, y, 0.0] for y in (-w, 0.0, w) for x in (-w, 0.0, w)]
    top = [[-w, -w, h], [w, -w, h], [w, w, h], [-w, w, h]]
    foot = [[-w, -w, 0.0], [w, -w, 0.0], [w, w, 0.0], [-w, w, 0.0]]
    faces = []
    for row in range(2):
        for column in range(2):
            a = 3 * row + column
            faces += [[a, a + 1, a + 4], [a, a + 4, a + 3]]
    for side in range(4):
        a, b = 9 + side, 9 + (side + 1) % 4
        faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    mesh = Mesh.from_arrays(floor + foot + top, faces)
    wanted = 4 / np.pi * np.sqrt(0.5) * np.arctan(np.sqrt(0.5))
    assert abs(wanted - 0.5541) < 1e-4
    for rays in (4, 6):
        bake = Bake.trace(mesh, rays)
        assert bake.mesh.normals is not None
        ambient, bent = ambient_and_bent(bake.bits, rays, bake.mesh.normals)
        assert np.abs(bent[4] - [0.0, 0.0, 1.0]).max() < 8 * U32  # by symmetry
        # Cells on the opening's edge are wholly seen or wholly hidden. It is a closed curve inside the square, so about
        # 4 sides of cells; each is off by half a cell at most, of weight below 2 / side².
        assert abs(float(ambient[4]) - wanted) < 4.0 / (1 << rays)


def test_maps_lie_as_the_concentric_square() -> None:
    rays, rng = 3, np.random.default_rng(2)
    visible = rng.uniform(size=(5, 64)) < 0.5
    maps = visibility_maps(packed(visible), rays)
    rows, columns = quadtree.morton_to_grid(rays)
    assert maps.shape == (5, 8, 8) and maps.dtype == np.uint8
    for sample in range(64):
        assert (maps[:, rows[sample], columns[sample]] == visible[:, sample]).all()


@pytest.mark.parametrize("ending", [".npz", ".zarr"])
def test_the_command_writes_each_kind(
    tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if ending == ".zarr":
        pytest.importorskip("zarr", reason="bakes in a Zarr store take zarr")
    import OpenEXR
    from trimesh import load

    mesh = Mesh.from_arrays(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 2, 3], [0, 1, 4]]
    )
    bake, path = Bake.trace(mesh, 3), tmp_path / f"a{ending}"
    bake.save(path)
    assert bake.mesh.normals is not None
    ambient, bent = ambient_and_bent(bake.bits, 3, bake.mesh.normals)
    assert 0.0 < ambient.min() < ambient.max() <= 1.0

    assert cli.main(["occlusion", str(path), "-o", str(tmp_path / "a.npz2.npz"), "--vertices", "4", "0"]) == 0
    with np.load(tmp_path / "a.npz2.npz") as found:
        assert (found["ambient_occlusion"] == ambient).all() and (found["bent_normals"] == bent).all()
        assert (found["faces"] == mesh.faces).all() and (found["vertices"] == mesh.vertices).all()
        assert (found["maps"] == visibility_maps(bake.bits[[4, 0]], 3)).all()

    assert cli.main(["occlusion", str(path), "-o", str(tmp_path / "a.ply")]) == 0
    read = read_mesh(tmp_path / "a.ply")
    assert (read.vertices == mesh.vertices).all() and (read.faces == mesh.faces).all()
    assert read.normals is not None and np.abs(read.normals - bent).max() < 4 * U32
    grey = load(tmp_path / "a.ply", process=False).visual.vertex_colors[:, :3]
    assert (grey == np.rint(255 * ambient)[:, None]).all()

    assert cli.main(["occlusion", str(path), "-o", str(tmp_path / "a.exr"), "--vertices", "0", "3", "4"]) == 0
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        red, alpha = (file.channels()[name].pixels for name in "RA")
    assert red.shape == (16, 16)
    for place, vertex in enumerate((0, 3, 4)):
        tile = np.s_[8 * (place // 2) : 8 * (place // 2) + 8, 8 * (place % 2) : 8 * (place % 2) + 8]
        assert (red[tile] == visibility_maps(bake.bits[[vertex]], 3)[0]).all() and (alpha[tile] == 1.0).all()
    assert (alpha[8:, 8:] == 0.0).all()

    capsys.readouterr()
    for arguments, word in (
        (["-o", "a.txt"], "expected a name that ends in .ply, .npz, .exr"),
        (["-o", str(tmp_path / "b.exr")], "name their --vertices"),
        (["-o", str(tmp_path / "b.ply"), "--vertices", "1"], "leave out --vertices"),
        (["-o", str(tmp_path / "b.exr"), "--vertices", "5"], "expected numbers from 0 to 4, got 5"),
        (["-o", str(tmp_path / "b.exr"), "--vertices", "9" * 20], "got 99999999999999999999"),
        (["-o", str(tmp_path / "b.exr"), "--vertices", *["0"] * 4097], "expected at most 4096, got 4097"),
    ):
        assert cli.main(["occlusion", str(path), *arguments]) == 2
        assert word in capsys.readouterr().err
