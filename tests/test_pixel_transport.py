"""Kernels of fixed views: transport rows, their product with many lights, hard light on pixels."""

from __future__ import annotations

import numpy as np
import pytest
from cases import frames as random_frames
from every_kernel import all_materials, directions
from guard import guard_bands
from tolerances import UNIT, assert_close, dot

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form
from prtcl.factors import sphere
from prtcl.factors.pixel_visibility import Pixels, cell_turns
from prtcl.factors.slices import Materials
from prtcl.transport import pixel_transport
from prtcl.transport.pixel_transport import PANEL, PRODUCT, Grids, Tile

COUNTS = (1, 4, 3, 16, 2, 5)
"""Points of each pixel."""


def scene(seed: int = 0) -> tuple[Pixels, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels of `COUNTS` points with random frames, views and materials."""
    pixels = Pixels.of(np.repeat(np.arange(len(COUNTS)), COUNTS))
    total = sum(COUNTS)
    material = np.random.default_rng(seed).integers(0, 6, total).astype(np.int32)
    return pixels, random_frames(total, seed).astype(np.float64), directions(total), material


def tile_of(device: Device, pixels: Pixels, frames: np.ndarray, views: np.ndarray, bits: np.ndarray) -> Tile:
    outgoing = np.zeros((len(views), 4))
    outgoing[:, :3] = views
    return Tile(
        device.array(pixels.first, np.int32), device.array(pixels.phase, np.int32), device.array(frames),
        device.array(outgoing), bits, device.array(bits, np.uint32),
    )  # fmt: skip


def random_bits(rows: int, rays: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    seen = np.random.default_rng(seed).uniform(size=(rows, sphere.n_cells(rays))) < 0.6
    return seen, np.packbits(seen, axis=1, bitorder="little").view(np.uint32)


@pytest.mark.parametrize(("light", "fine", "rays"), [(2, 2, 2), (1, 2, 2), (2, 3, 2), (3, 3, 2), (1, 3, 3)])
def test_transport_is_its_definition(device: Device, light: int, fine: int, rays: int) -> None:
    pixels, frames, views, material = scene()
    chosen = all_materials()
    seen, bits = random_bits(len(pixels), rays)
    cells = np.flatnonzero(np.random.default_rng(1).uniform(size=sphere.n_cells(light)) < 0.7).astype(
        np.int32
    )
    with guard_bands(device):
        rows = pixel_transport.transport(
            device, Materials(device, chosen), device.array(material, np.int32),
            tile_of(device, pixels, frames, views, bits), device.array(cells, np.int32), Grids(light, fine, rays), 3,
        ).get()  # fmt: skip
    world = sphere.centres(fine)[:, :3].astype(np.float64)
    number = np.arange(sphere.n_cells(fine))
    bit = number >> 2 * (fine - rays)
    each = 4 ** (fine - light)
    expected = np.zeros((3, len(pixels), len(cells)))
    for pixel in range(len(pixels)):
        point = pixels.point(np.full(len(number), pixel), cell_turns(bit))
        values = np.zeros((len(number), 3))
        for d in number:
            local = frames[point[d]] @ world[d]
            if seen[pixel, bit[d]] and local[2] > 0:
                f = reference.brdf(chosen[material[point[d]]].reference(), local[None], views[point[d]][None])
                values[d] = f[0] * local[2]
        whole = values.reshape(-1, each, 3).sum(axis=1) * (2 * np.pi / 4**fine)
        expected[:, pixel] = whole[cells].T
    # f is good to some hundred roundings of itself (tests/test_brdf.py has the exact bounds).
    assert_close(rows, expected, 400 * UNIT["float32"] * np.abs(expected) + 1e-7, zeros=0.8)


def test_a_tile_names_the_cells_that_it_sees(device: Device) -> None:
    pixels, frames, views, _ = scene()
    bits = np.zeros((len(pixels), 1), dtype=np.uint32)
    bits[2, 0], bits[4, 0] = 1 << 5, 1 << 30
    tile = tile_of(device, pixels, frames, views, bits)
    assert tile.seen(2, 2).tolist() == [5, 30]
    assert tile.seen(2, 1).tolist() == [1, 7]
    assert tile.seen(2, 3).tolist() == [20, 21, 22, 23, 120, 121, 122, 123]


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("form", PRODUCT.forms, ids=lambda form: f"{form.name}{form.size}")
def test_the_product_is_exact_in_integers(device: Device, form: Form, channels: int) -> None:
    if form.name == "wide" and not device.takes_vectors:
        pytest.skip("kernels on vectors of sixteen are a CPU's")
    rng = np.random.default_rng(3)
    for pixels, count, environments in ((1, 1, 1), (form.size + 1, 37, 16), (2 * form.size + 3, 5, 33)):
        rows = rng.integers(-8, 9, (channels, pixels, count))
        lights = rng.integers(0, 9, (environments, 2 * count, 3))
        cells = np.sort(rng.choice(2 * count, count, replace=False)).astype(np.int32)
        with PRODUCT.trial(form), guard_bands(device):
            got = pixel_transport.product(
                device, device.array(rows), device.array(pixel_transport.panels(lights.astype(np.float32))),
                device.array(cells, np.int32),
            ).get()  # fmt: skip
        expected = np.einsum("cpk,ekc->pce", np.broadcast_to(rows, (3, pixels, count)), lights[:, cells])
        assert (got[..., :environments] == expected).all()
        assert (got[..., environments:] == 0).all() and got.shape[2] % PANEL == 0


def test_every_form_of_the_product_gives_the_same_bytes(any_device: Device) -> None:
    """And those of the plain twin: each sum runs over the cells in order."""
    device, rng = any_device, np.random.default_rng(4)
    rows = device.array(rng.normal(size=(3, 19, 301)))
    lights = pixel_transport.panels(rng.uniform(size=(20, 400, 3)))
    cells = np.sort(rng.choice(400, 301, replace=False))
    columns, index = device.array(lights), device.array(cells, np.int32)
    twin = device.kernels("pixel_product.cl", CHANNELS=3, PANEL=PANEL)["pixel_product_plain"]
    plain = device.empty((19, 3, 2 * PANEL))
    device.launch(twin, 6 * PANEL, 16, rows, columns, 400, index, 301, 19, 2, plain, y=19)
    expected = plain.get()
    host = np.broadcast_to(rows.get().astype(np.float64), (3, 19, 301))
    light = columns.get().astype(np.float64).reshape(3, 2, 400, PANEL)[:, :, cells]
    terms = np.einsum("cpk,cnke->pcnek", host, light).reshape(19, 3, 2 * PANEL, 301)
    assert_close(expected, terms.sum(axis=3), dot(terms, 303, device.precision), zeros=0.5)
    for form in PRODUCT.forms:
        if form.name == "wide" and not device.takes_vectors:
            continue
        with PRODUCT.trial(form):
            assert (pixel_transport.product(device, rows, columns, index).get() == expected).all(), form


def test_hard_light_on_pixels_is_its_definition(device: Device) -> None:
    pixels, frames, views, material = scene(2)
    chosen = all_materials()
    rng = np.random.default_rng(5)
    begin, stride = np.array([0, 3, 3, 40], dtype=np.int32), 16
    lights = np.zeros((40, 2, 4))
    towards = rng.normal(size=(40, 3))
    lights[:, 0, :3] = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    lights[:, 1, :3] = rng.uniform(0.1, 1, (40, 3))
    turns = np.concatenate([np.arange(3), np.arange(37)]).astype(np.int32)
    seen = rng.uniform(size=(len(pixels), 64)) < 0.7
    bits = np.packbits(seen, axis=1, bitorder="little").view(np.uint32)
    soft, soft_bits = random_bits(len(pixels), 2, 6)
    corners, weights = sphere.around(lights[:, 0, :3], 2)
    corners[::2] = -1
    start = rng.uniform(size=(len(pixels), 3, stride)).astype(np.float32)
    known, tile = Materials(device, chosen), tile_of(device, pixels, frames, views, soft_bits)
    with guard_bands(device):
        out = device.array(start)
        kernel = device.kernels("pixel_lights.cl", KINDS=known.mask, GROUP=64)["pixel_lights"]
        device.launch(
            kernel, len(pixels), 64, *known.arguments, device.array(material, np.int32), device.array(lights),
            device.array(turns, np.int32), device.array(begin, np.int32), device.array(bits, np.uint32), 2,
            tile.device_bits, 1, device.array(corners, np.int32), device.array(weights), tile.frames,
            tile.views, tile.first, tile.phase, len(pixels), stride, out, y=3,
        )  # fmt: skip
        got = out.get()
    expected = start.astype(np.float64)
    for pixel in range(len(pixels)):
        for environment in range(3):
            for l in range(begin[environment], begin[environment + 1]):
                ways = [(seen[pixel, l], turns[l], 1.0)]
                if corners[l, 0] >= 0:
                    ways = list(zip(soft[pixel, corners[l]], cell_turns(corners[l]), weights[l], strict=True))
                for visible, turn, weight in ways:
                    point = int(pixels.point(np.array(pixel), np.array(turn)))
                    local = frames[point] @ lights[l, 0, :3]
                    if visible and local[2] > 0:
                        f = reference.brdf(
                            chosen[material[point]].reference(), local[None], views[point][None]
                        )[0]
                        expected[pixel, :, environment] += weight * f * local[2] * lights[l, 1, :3]
    assert_close(got, expected, 400 * UNIT["float32"] * np.abs(expected) + 1e-7)
    assert (got[..., 1] == start[..., 1]).all() and (got[..., 3:] == start[..., 3:]).all()


def test_panels_hold_each_environment_as_a_column() -> None:
    lights = np.arange(17 * 4 * 3, dtype=np.float32).reshape(17, 4, 3)
    panels = pixel_transport.panels(lights)
    assert panels.shape == (6, 4, PANEL)
    assert (panels[0, :, 5] == lights[5, :, 0]).all() and (panels[3, :, 0] == lights[16, :, 1]).all()
    assert (panels[1, :, 1:] == 0).all()


def test_bytes_are_those_of_the_arrays(device: Device) -> None:
    real = np.dtype(device.dtype).itemsize
    wanted = real * (3 * sphere.n_cells(4) + 3 * 32)
    assert pixel_transport.bytes_per_pixel(device, Grids(4, 4, 4), 3, 17) == wanted
