"""The environment: orientation, energy, the split into soft and hard light, and the gather kernel."""

from __future__ import annotations

from functools import lru_cache

import cases
import numpy as np
import pytest
import tolerances
from guard import guard_bands
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tolerances import assert_close

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import environment, hardlight, hemisphere
from prtcl.factors.environment import Environment
from prtcl.factors.sequence import shuffled, stratified

SUB = getattr(environment, "SUB", 1)
"""Levels of subsamples that the gather takes in a cell."""

UP_AND_DOWN = np.array(
    [[[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]]], dtype=np.float32
)
"""Frames over +y and −y: between them they see every direction once."""


def map_directions(height: int) -> NDArray[np.float64]:
    """World directions of the texel centres (h, 2 h, 3)."""
    theta = np.pi * (np.arange(height) + 0.5)[:, None] / height
    phi = 2 * np.pi * (np.arange(2 * height) + 0.5)[None] / (2 * height)
    return np.stack(
        [np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi, -np.sin(theta) * np.cos(phi)], axis=-1
    )


def solid_angles(height: int) -> NDArray[np.float64]:
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return np.repeat((edges[:-1] - edges[1:])[:, None] * np.pi / height, 2 * height, axis=1)


def smooth(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radiance of low order in the direction: |gradient| ≤ 2 and |second derivative| ≤ 4 in every channel."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([3 + x + 0.5 * y, 3 + y * z + 0.5 * x, 3 - z + 0.5 * x * y], axis=-1)


@lru_cache(maxsize=1)
def sun_map(height: int, towards: tuple[float, ...], degrees: float) -> NDArray[np.float32]:
    """A dim sky and a disk of a sun, antialiased: each texel's share of it by 4 × 4 points."""
    fine = map_directions(height * 4)
    inside = (fine @ towards > np.cos(np.radians(degrees / 2))).astype(np.float64)
    share = inside.reshape(height, 4, 2 * height, 4).mean(axis=(1, 3))
    assert share.sum() > 0
    return (0.1 + 5e5 * share[..., None] * np.array([1.0, 0.9, 0.7])).astype(np.float32)


# --- orientation --------------------------------------------------------------------------------------------


def turned(directions: NDArray[np.float64], degrees: float) -> NDArray[np.float64]:
    """Counter-clockwise about +y, seen from above (from +y, with x to the right and z down the page)."""
    a = np.radians(degrees)
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([x * np.cos(a) + z * np.sin(a), y, z * np.cos(a) - x * np.sin(a)], axis=-1)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 180.0, -77.0, 400.0])
def test_rotation_is_about_the_up_axis_counter_clockwise(degrees: float) -> None:
    d = np.random.default_rng(1).normal(size=(50, 3))
    environment = Environment(np.ones((2, 4, 3), np.float32), rotate=degrees)
    # What the map holds at d is seen in the world at d turned.
    assert_close(turned(d, degrees) @ environment.to_map.T, d, 1e-14)
    # Seen from above +x is right and −z is up the page, so a quarter turn takes +x to −z.
    assert_close(turned(np.array([1.0, 0, 0]), 90.0), [0, 0, -1.0], 1e-15, zeros=0.7)


def test_z_up_map() -> None:
    """World +z is the map's zenith; the frame stays right-handed and +x stays."""
    m = Environment(np.ones((2, 4, 3), np.float32), up="z").to_map
    assert (m @ [0, 0, 1] == [0, 1, 0]).all()
    assert (m @ [1, 0, 0] == [1, 0, 0]).all()
    assert np.linalg.det(m) == 1
    a = np.radians(25)
    spun = Environment(np.ones((2, 4, 3), np.float32), up="z", rotate=25.0).to_map
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    assert_close(spun @ about_z, m, 1e-15, zeros=0.7)


# --- the gather ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", range(1, 8))
def test_constant_is_exact(device: Device, levels: int) -> None:
    radiance = (0.3, 1.7, 123.456)
    light = Environment.constant(radiance).split(levels)
    assert not len(light.hard)
    frames = cases.frames(65 if levels <= 3 else 3)
    with guard_bands(device):
        got = environment.gather(device, light, frames).get()
    assert (got == np.float32(radiance)[None, :, None]).all()


def test_grey_constant_in_one_channel(device: Device) -> None:
    light = Environment.constant(0.7).split(4)
    assert light.grey
    with guard_bands(device):
        got = environment.gather(device, light, cases.frames(63), channels=1).get()
    assert got.shape == (63, 1, 4**4)
    assert (got == np.float32(0.7)).all()


@pytest.mark.parametrize(("rotate", "up"), [(0.0, "y"), (50.0, "y"), (0.0, "z"), (-120.0, "z")])
@pytest.mark.parametrize("levels", [3, 5])
def test_smooth_map_is_averaged_over_cells(device: Device, levels: int, rotate: float, up: str) -> None:
    """Against float64 averages of `reference.environment` over 64 directions a cell.

    With h = 2/face the cube texel's spacing, M₁ = 2 and M₂ = 4 the map's derivatives: spreading bilinearly
    (variance h²/6 an axis) and interpolating (h²/8 an axis) err by M₂ h² (1/6 + 1/4); border texels are
    taken from the neighbour's nearest, off by at most h/2 with a weight of at most 1/2: M₁ h/4; the map's
    own bilinear surface, on both sides, is within M₂ (π/H)²/4; the midpoints of a cell's subcells, of area
    cell²/4**SUB, err by M₂ cell²/12 / 4**SUB.
    """
    height = 32
    image = smooth(map_directions(height)).astype(np.float32)
    light = Environment(image, rotate=rotate, up=up).split(levels, "off")
    frames = cases.frames(4)
    got = environment.gather(device, light, frames).get()
    fine = reference.directions(levels + 3)
    for point in range(4):
        world = fine @ frames[point].astype(np.float64)
        if up == "z":
            world = np.stack([world[:, 0], world[:, 2], -world[:, 1]], axis=1)
        seen = reference.environment(image, turned(world, -rotate))
        expected = seen.reshape(4**levels, 64, 3).mean(axis=1).T
        h, cell2 = 2 / environment.cube_face(levels), 2 * np.pi / 4**levels
        bound = (
            4 * h**2 * (1 / 6 + 1 / 4) + 2 * h / 4 + 4 * (np.pi / height) ** 2 / 4 + 4 * cell2 / 12 / 4**SUB
        )
        assert_close(got[point], expected, bound)
        # Away from face edges the first-order term is gone; most cells are.
        assert np.median(np.abs(got[point] - expected)) < (bound - 2 * h / 4) / 4


def cube_radiance(cube: NDArray[np.float32], d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bilinear lookup in faces +x −x +y −y +z −z with one texel of border, from the definition.

    On the face of axis a the coordinates are the other axes in cyclic order over |d_a|, the first along
    columns; texel i of the face, which is entry i + 1, is centred at −1 + (2 i + 1)/face.
    """
    face = cube.shape[1] - 2
    axis = np.abs(d).argmax(axis=1)
    n = np.arange(len(d))
    major = d[n, axis]
    along, across = (d[n, (axis + k) % 3] / np.abs(major) for k in (1, 2))
    x, y = ((c + 1) / 2 * face + 0.5 for c in (along, across))
    i, j = (np.minimum(np.floor(c).astype(int), face) for c in (x, y))
    fx, fy = (x - i)[:, None], (y - j)[:, None]
    texels = cube[2 * axis + (major < 0)].astype(np.float64)
    top = texels[n, j, i] * (1 - fx) + texels[n, j, i + 1] * fx
    bottom = texels[n, j + 1, i] * (1 - fx) + texels[n, j + 1, i + 1] * fx
    return top * (1 - fy) + bottom * fy


@pytest.mark.parametrize("levels", [1, 2, 4, 6])
@pytest.mark.parametrize("points", [1, 5])
def test_every_texel_of_a_rough_cube_is_read_where_it_lies(device: Device, levels: int, points: int) -> None:
    face = 3 if levels < 6 else 16
    cube = np.random.default_rng(levels).uniform(0, 1, (6, face + 2, face + 2, 4)).astype(np.float32)
    light = environment.Light(cube, np.zeros((0, 6)), np.eye(3), levels, 0.0)
    frames = cases.frames(points)
    with guard_bands(device):
        got = environment.gather(device, light, frames).get()
    fine = hemisphere.directions(levels + SUB)[:, :3].astype(np.float64)
    for point in range(points):
        world = fine @ frames[point].astype(np.float64)
        # On an edge rounding may choose the other face, whose border holds other numbers in this cube.
        two = np.sort(np.abs(world), axis=1)
        sure = ((two[:, 2] - two[:, 1]) > 1e-5).reshape(-1, 4**SUB).all(axis=1)
        assert sure.mean() > 0.7
        expected = cube_radiance(cube, world).reshape(4**levels, 4**SUB, 4).mean(axis=1)[:, :3]
        # A texel coordinate of up to face + 1 is good to 8 u of that, slopes are below 1 a texel in each.
        bound = (2 * 8 * (face + 1) + 16) * 2.0**-24
        assert_close(got[point].T[sure], expected[sure], bound)


@pytest.mark.parametrize("levels", [2, 5])
def test_the_cubes_border_continues_its_neighbours(levels: int) -> None:
    """A smooth function of direction is still that function one texel beyond a face's edge."""
    image = smooth(map_directions(64)).astype(np.float32)
    cube = Environment(image).split(levels, "off").cube[..., :3]
    face = cube.shape[1] - 2
    centre = (np.arange(face + 2) - 0.5) / face * 2 - 1
    t, s = np.meshgrid(centre, centre, indexing="ij")
    for which in range(6):
        axis, sign = which // 2, -1.0 if which % 2 else 1.0
        d = np.empty((face + 2, face + 2, 3))
        d[..., axis], d[..., (axis + 1) % 3], d[..., (axis + 2) % 3] = sign, s, t
        expected = smooth(d / np.linalg.norm(d, axis=-1, keepdims=True))
        # Half a texel along the edge off the neighbour's nearest, and what spreading costs: M₁ h/2 + M₁ h/4 +
        # M₂ h².
        h = 2 / face
        assert_close(cube[which], expected, 2 * h / 2 + 2 * h / 4 + 4 * h**2 + 4 * (np.pi / 64) ** 2)


def test_gather_does_not_depend_on_the_precision(make_device) -> None:
    image = np.random.default_rng(3).uniform(0, 5, (8, 16, 3)).astype(np.float32)
    light = Environment(image).split(4, "off")
    frames = cases.frames(5)
    single = environment.gather(make_device("float32"), light, frames).get()
    double = environment.gather(make_device("float64"), light, frames).get()
    # A texel coordinate s of up to face + 1 is good to 8 u of that; the cube's steepest slope is 5 a texel,
    # twice.
    bound = 2 * 5 * 8 * 2.0**-24 * (environment.cube_face(4) + 2) + 8 * 2.0**-24 * 5
    assert_close(single, double, bound)


def test_two_runs_agree_bit_for_bit(device: Device) -> None:
    image = np.random.default_rng(3).uniform(0, 5, (8, 16, 3)).astype(np.float32)
    image[2, 3] = 1e5
    light = Environment(image).split(4)
    assert len(light.hard)
    frames = cases.frames(9)
    first, second = (environment.gather(device, light, frames, splat_hard=True).get() for _ in range(2))
    assert (first == second).all()


# --- energy -------------------------------------------------------------------------------------------------

SUN = (0.48, 0.6, -0.64)


@pytest.mark.parametrize("levels", range(2, 8))
def test_a_half_degree_sun_keeps_its_energy(device: Device, levels: int) -> None:
    """Radiance times solid angle over both hemispheres is the map's, within 1 %, whatever the grid."""
    height = 256  # texels of 0.7 degrees
    image = sun_map(height, SUN, 0.5)
    light = Environment(image).split(levels)
    assert light.hard_share > 0.9
    with guard_bands(device):
        samples = environment.gather(device, light, UP_AND_DOWN, splat_hard=True).get().astype(np.float64)
    total = samples.sum(axis=(0, 2)) * 2 * np.pi / 4**levels
    expected = (image.astype(np.float64) * solid_angles(height)[..., None]).sum(axis=(0, 1))
    assert_close(total, expected, 0.01 * expected)
    # The sun falls into one cell or a few of them, of the upper hemisphere.
    assert (samples[0, 0] > 10).sum() <= max(4, 4**levels // 500)
    assert samples[1].max() < 1


def test_hard_samples_fall_into_their_own_cells(device: Device) -> None:
    levels = 5
    rng = np.random.default_rng(5)
    image = np.full((4, 8, 3), 0.0, np.float32)
    light = Environment(image).split(levels)
    u, v = (rng.integers(0, 2**levels, (2, 40)) + rng.uniform(0.05, 0.95, (2, 40))) / 2**levels
    frames = cases.frames(3)
    local = reference.square_to_hemisphere(u, v)
    world = local @ frames[1].astype(np.float64)
    energy = rng.uniform(1, 2, (40, 3))
    lights = environment.Light(light.cube, np.concatenate([world, energy], axis=1), light.to_map, levels, 1.0)
    got = environment.gather(device, lights, frames, splat_hard=True).get()
    place = np.zeros((4**levels, 3))
    from prtcl import quadtree

    cell = quadtree.grid_to_morton(levels)[(v * 2**levels).astype(int), (u * 2**levels).astype(int)]
    np.add.at(place, cell, energy * 4**levels / (2 * np.pi))
    assert_close(got[1].T, place, tolerances.dot(place[..., None], 8, "float32"), zeros=1)
    assert (place > 0).sum() > 60
    # Elsewhere: what lies above that point's horizon, and nothing of what lies below.
    above = (world @ frames[0][2].astype(np.float64)) > 0
    total = got[0].astype(np.float64).sum(axis=1) * 2 * np.pi / 4**levels
    assert_close(total, energy[above].sum(axis=0), 60 * 2.0**-24 * energy.sum(axis=0))


@pytest.mark.parametrize("levels", [3, 6])
def test_soft_and_hard_add_up_to_the_map(levels: int) -> None:
    """Energy by channel: the cube's texels times their solid angles, plus the hard samples."""
    height = 32
    rng = np.random.default_rng(levels)
    image = np.exp(rng.normal(size=(height, 2 * height, 3))).astype(np.float32)
    image[5, 7], image[20, 40] = (9e4, 4e4, 1e4), (3e3, 3e3, 9e3)
    light = Environment(image).split(levels)
    assert len(light.hard) >= 2
    inner = light.cube[:, 1:-1, 1:-1, :3].astype(np.float64)
    # Solid angle of a cube texel: the corner formula atan(s t/√(1 + s² + t²)).
    edge = np.linspace(-1, 1, inner.shape[1] + 1)
    s, t = np.meshgrid(edge, edge)
    corner = np.arctan(s * t / np.sqrt(1 + s**2 + t**2))
    texel = corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1]
    assert_close(6 * texel.sum(), 4 * np.pi, 1e-12)
    soft = (inner * texel[None, :, :, None]).sum(axis=(0, 1, 2))
    hard = light.hard[:, 3:].sum(axis=0)
    expected = (image.astype(np.float64) * solid_angles(height)[..., None]).sum(axis=(0, 1))
    # Texels of the map and of the cube do not line up: their solid angles agree in the mean, to 2 % of the
    # soft part; bilinear interpolation moves a peak's energy between rows of other solid angle, 1 % of the
    # hard part.
    assert_close(soft + hard, expected, 0.02 * soft + 0.01 * hard)
    assert_close(light.hard_share, hard.sum() / expected.sum(), 0.02)
    # What is left in the cube is below the threshold, by the mean of the channels.
    mean = float((image.mean(axis=2) * solid_angles(height)).sum() / (4 * np.pi))
    threshold = environment.HARD_SHARE * np.pi * mean / (2 * np.pi / 4**environment.HARD_LEVELS)
    assert inner.mean(axis=3).max() <= threshold * (1 + 1e-6)


def test_clip_parts_add_up() -> None:
    radiance = np.exp(3 * np.random.default_rng(1).normal(size=(500, 3)))
    soft, hard = hardlight.clip(radiance, 2.0)
    assert_close(soft + hard, radiance, 2 * 2.0**-53 * radiance)
    assert (soft.mean(axis=1) <= 2.0 * (1 + 1e-15)).all()
    assert not hard[radiance.mean(axis=1) <= 2.0].any()
    over = radiance.mean(axis=1) > 2.0
    assert_close(
        soft[over] / radiance[over], np.repeat(soft[over, :1] / radiance[over, :1], 3, axis=1), 1e-15
    )


@given(seed=st.integers(0, 2**31), count=st.integers(1, 300), most=st.integers(1, 40))
def test_clusters_keep_all_energy_and_unit_directions(seed: int, count: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    d = rng.normal([0, 3, 0], 0.2, (count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    energy = np.exp(3 * rng.normal(size=(count, 3)))
    samples = hardlight.cluster(d, energy, most)
    assert 1 <= len(samples) <= most
    assert_close(samples[:, 3:].sum(axis=0), energy.sum(axis=0), count * 2.0**-53 * energy.sum(axis=0))
    assert_close(np.linalg.norm(samples[:, :3], axis=1), np.ones(len(samples)), 4 * 2.0**-53)
    assert (samples[:, 3:] > 0).all()


def test_clusters_of_nothing_and_of_darkness() -> None:
    assert hardlight.cluster(np.zeros((0, 3)), np.zeros((0, 3)), 10).shape == (0, 6)
    assert hardlight.cluster(np.eye(3), np.zeros((3, 3)), 10).shape == (0, 6)
    assert hardlight.cluster(np.eye(3), np.ones((3, 3)), 0).shape == (0, 6)


def test_equal_directions_do_not_split_for_ever() -> None:
    same = np.broadcast_to([0.0, 1.0, 0.0], (50, 3))
    assert len(hardlight.cluster(same, np.ones((50, 3)), 30)) == 1


def test_subtexels_have_the_texels_solid_angles() -> None:
    image = np.random.default_rng(2).uniform(0, 1, (6, 12, 3))
    rows, columns = np.mgrid[0:6, 0:12].reshape(2, -1)
    parts = hardlight.subtexels(image, rows, columns, 4)
    assert_close(parts.solid_angles.reshape(6, 12, 16).sum(axis=2), solid_angles(6), 1e-14)
    assert_close(np.linalg.norm(parts.directions, axis=1), np.ones(6 * 12 * 16), 1e-15)
    assert_close(parts.radiance, reference.environment(image, parts.directions), 1e-12)


# --- hemisphere ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", range(0, 8))
def test_directions_and_mean_cosines(levels: int) -> None:
    got = hemisphere.directions(levels)
    assert_close(got[:, :3], reference.directions(levels), 2.0**-24, zeros=0.7)
    # The mean cosines are exact: they integrate to π.
    assert_close(got[:, 3].astype(np.float64).sum() * 2 * np.pi / 4**levels, np.pi, 2.0**-24 * np.pi)
    fine = reference.directions(levels + 3)[:, 2].reshape(4**levels, 64).mean(axis=1)
    # The midpoint rule over 64 points errs by h²/12 of a cell an eighth as wide, h/3 on the diagonals'
    # eighth.
    h = 2 / 2**levels
    assert_close(got[:, 3], fine, h**2 / 64 / 12 + (h / 8) / 3 / 8 + 2.0**-24)


def test_cell_offsets_move_the_sample_inside_its_cell() -> None:
    assert hemisphere.cell_offset(hemisphere.ALONE) == (0.5, 0.5)
    offsets = np.array([hemisphere.cell_offset(i) for i in range(64)])
    assert ((offsets >= 0) & (offsets < 1)).all()
    assert len(np.unique((offsets * 4).astype(int), axis=0)) == 16  # every sixteenth of the cell is visited
    moved = hemisphere.directions(4, hemisphere.cell_offset(3))
    assert_close(moved[:, :3], reference.directions(4, hemisphere.cell_offset(3)), 2.0**-24)


def test_places_in_pixel_and_cell_move_apart() -> None:
    # Aligned runs of 2**k numbers go to such runs, the first to itself: cell places are as even as pixel places.
    order = np.array([shuffled(i) for i in range(1024)])
    for k in range(11):
        runs = np.sort(order.reshape(-1, 1 << k), axis=1)
        assert (np.diff(runs, axis=1) == 1).all() and (runs[:, 0] % (1 << k) == 0).all()
        assert runs[0, 0] == 0
    # Sub-pixel place and cell place together: 256 numbers are near to independent in their four dimensions. Without
    # the shuffle they correlate fully, and fill 16 of the 256 boxes of a 4 x 4 x 4 x 4 grid.
    pixel = np.stack(stratified(np.arange(256)), axis=1)
    cell = np.array([hemisphere.cell_offset(i) for i in range(256)])
    boxes = np.unique(np.floor(4 * np.concatenate([pixel, cell], axis=1)), axis=0)
    assert len(boxes) > 100
    assert np.abs(np.corrcoef(pixel.T, cell.T)[:2, 2:]).max() < 4 / np.sqrt(256)


@given(seed=st.integers(0, 2**31))
def test_to_square_is_the_inverse(seed: int) -> None:
    u, v = np.random.default_rng(seed).uniform(0, 1, (2, 100))
    d = hemisphere.from_square(u, v)
    assert_close(d, reference.square_to_hemisphere(u, v), 1e-15)
    assert_close(np.stack(hemisphere.to_square(d)), np.stack([u, v]), 1e-7)
    assert np.allclose(hemisphere.to_square([0.0, 0.0, 1.0]), 0.5)


@pytest.mark.parametrize("towards", [False, True])
def test_frames_are_orthonormal_and_right_handed(towards: bool) -> None:
    rng = np.random.default_rng(2)
    n = rng.normal(size=(500, 3))
    n = np.concatenate([n / np.linalg.norm(n, axis=1, keepdims=True), np.eye(3), -np.eye(3)])
    view = rng.normal(size=n.shape) if towards else None
    if view is not None:
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        view[0] = n[0]  # a view along the normal has no projection
    f = hemisphere.frames_from(n, view).astype(np.float64)
    assert_close(f @ f.transpose(0, 2, 1), np.broadcast_to(np.eye(3), f.shape), 8 * 2.0**-24, zeros=0.7)
    assert_close(np.linalg.det(f), np.ones(len(n)), 16 * 2.0**-24)
    assert_close(f[:, 2], n, 2.0**-24)
    if view is not None:
        across = np.einsum("ij,ij->i", f[:, 1], view)
        assert np.abs(across[1:]).max() < 1e-6
        assert (np.einsum("ij,ij->i", f[1:, 0], view[1:]) > 0).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image": np.ones((4, 4, 3))}, r"\(h, 2 h, 3\), got \(4, 4, 3\)"),
        ({"image": np.ones((4, 8))}, r"\(h, 2 h, 3\)"),
        ({"image": np.full((4, 8, 3), np.nan)}, "finite radiance"),
        ({"image": -np.ones((4, 8, 3))}, "0 or more"),
        ({"up": "x"}, "env-up: expected y or z, got 'x'"),
        ({"rotate": np.inf}, "env-rotate"),
    ],
)
def test_bad_environments_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Environment(**{"image": np.ones((4, 8, 3)), "name": "sky.hdr", **change})
