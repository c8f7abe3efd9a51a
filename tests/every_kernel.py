"""Launch every kernel of kernels/*.cl on the OpenCL device in sight: `python tests/every_kernel.py`.

Through the public functions, and the plain twins directly, at small sizes about the edges of a work-group, in every
precision that the device has; answers are held against `prtcl.reference` where that is cheap. It fails if a kernel
of the sources was not launched. Made for `.ci/opencl oclgrind`, which then reports invalid accesses and races: the
arrays are made one by one at their exact sizes, since an access beyond one would otherwise end inside the pool.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from typing import Any

import cases
import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from prtcl import quadtree, reference
from prtcl.compute.device import Device
from prtcl.compute.source import kernel_folder
from prtcl.factors import environment, hemisphere, sphere
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.environment import Environment, Light
from prtcl.factors.material import Material, from_table
from prtcl.factors.measured import Measured
from prtcl.factors.pixel_visibility import Pixels, cell_turns
from prtcl.factors.slice_operator import SliceOperator
from prtcl.factors.slices import Materials
from prtcl.factors.table_slices import TableSlices
from prtcl.transport import collapse, cut, pixel_transport, shade
from prtcl.transport.hard_tree import HardSums
from prtcl.transport.leaves import Leaves, Squares
from prtcl.transport.settings import Settings
from prtcl.wavelet import haar, masked, pyramid, triple

POINTS = 65
"""One more than a work-group."""

KERNEL = re.compile(r"\b(?:__)?kernel\b[^;{}]*?\bvoid\s+(\w+)\s*\(")
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)


def kernels_of_the_sources(wide: bool = True) -> list[str]:
    """Names of all kernels of kernels/*.cl, each once; without `wide` those in vectors of sixteen are left out."""
    found: list[str] = []
    for path in sorted(kernel_folder().glob("*.cl")):
        if not wide and path.stem.endswith("_wide"):
            continue
        names = KERNEL.findall(COMMENT.sub(" ", path.read_text(encoding="utf-8")))
        assert names, f"{path.name}: no kernel was found in it"
        found += names
    twice = [name for name, count in Counter(found).items() if count > 1]
    assert not twice, f"kernels of one name in two files: {twice}"
    return found


class Watched(Device):
    """A device that remembers what it launched, and whose arrays are buffers of exactly their own size."""

    def __init__(self, precision: str) -> None:
        super().__init__(precision=precision)
        self.launched: Counter[str] = Counter()
        # With OCLGRIND_UNINITIALIZED=1 Oclgrind reports what is uploaded to where a freed buffer was.
        self.alive: list[Any] = []

    def launch(self, kernel: Any, *arguments: Any, **options: Any) -> Any:
        event = super().launch(kernel, *arguments, **options)
        if event is not None:
            self.launched[kernel.function_name] += 1
        return event

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike | None = None) -> Any:
        import pyopencl.array as cla

        self.alive.append(cla.empty(self.queue, shape, dtype or self.dtype))
        return self.alive[-1]


def close(device: Device, got: ArrayLike, expected: ArrayLike, slack: float = 1.0) -> None:
    """|got − expected| ≤ slack · 1e-5 of the largest expected value (1e-12 in float64); tight bounds are pytest's."""
    got, expected = np.asarray(got), np.asarray(expected)
    assert got.shape == expected.shape, f"shape {got.shape}, expected {expected.shape}"
    largest = np.abs(expected).max()
    assert largest > 0, "nothing was compared"
    error = np.abs(got - expected).max() / largest
    limit = slack * (1e-12 if device.precision == "float64" else 1e-5)
    assert error <= limit, f"error {error:.3g} of the largest value, limit {limit:.3g}"


def haar_both_ways(device: Device) -> None:
    twins = device.kernels("haar_plain.cl", GROUP=8)
    for levels, rows in ((1, POINTS), (3, 9), (4, 3)):
        x = cases.light_samples("random", rows, levels)
        samples = device.array(x)
        coefficients = haar.forward(device, samples)
        close(device, coefficients.get(), reference.haar(x))
        close(device, haar.inverse(device, coefficients).get(), x)
        out, scratch = device.empty(x.shape), device.empty(x.shape)
        device.launch(twins["haar_forward_plain"], rows, 8, samples, out, scratch, rows, levels)
        close(device, out.get(), reference.haar(x))
        device.launch(twins["haar_inverse_plain"], rows, 8, coefficients, out, rows, levels)
        close(device, out.get(), x)


def triple_products(device: Device) -> None:
    for levels, points, channels, channels_b in ((1, POINTS, 1, 1), (3, 5, 3, 1), (4, 2, 3, 3)):
        a, b = (
            cases.light_samples("random", points * count, levels, seed).reshape(points, count, -1)
            for seed, count in enumerate((channels, channels_b))
        )
        da, db = device.array(a), device.array(b)
        expected = reference.triple(a, b)
        for keep in {1, levels}:
            close(device, triple.reduce(device, da, db, keep=keep).get(), expected[..., : 4**keep])
        twin = device.kernels("triple.cl", LEVELS=levels, CHANNELS=channels, CHANNELS_B=channels_b, GROUP=64)
        rows = points * channels
        energy = device.empty((rows, quadtree.n_squares(levels)), triple.accumulator_dtype(device))
        out = device.empty(a.shape)
        device.launch(twin["triple_plain"], rows, 64, da, db, energy, out, rows)
        close(device, out.get(), expected)


def visibility(device: Device) -> None:
    for rays, levels, points in ((1, 2, POINTS), (2, 2, 3), (3, 4, 3), (4, 4, 5)):
        seen = cases.visibility(points, rays)
        expected = reference.haar(np.repeat(seen, 4 ** (levels - rays), axis=1).astype(np.float64))
        bits = device.array(cases.pack_bits(seen), np.uint32)
        got = masked.visibility_coefficients(device, bits, rays, levels).get()[:, 0]
        assert (got == expected).all()
        twin = device.kernels("visibility.cl", LEVELS=levels, BITS=rays, GROUP=64)
        out = device.empty((points, 4**levels))
        device.launch(twin["visibility_coefficients_plain"], 4**levels, 64, bits, out, y=points)
        assert (out.get() == expected).all()


def sky(levels: int, *, hard: bool = False) -> Light:
    """Constant radiance, and three hard samples if wanted."""
    light = Environment.constant((1.0, 2.0, 3.0)).split(levels)
    if not hard:
        return light
    towards = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.48, 0.6, -0.64]])
    power = np.arange(1.0, 10.0).reshape(3, 3)
    return Light(light.cube, np.concatenate([towards, power], axis=1), np.eye(3), levels, 0.5)


def environment_gathered_and_splat(device: Device) -> None:
    frames = cases.frames(POINTS).astype(np.float64)
    for levels, channels in ((2, 3), (3, 1)):
        light = sky(levels, hard=True)
        soft = environment.gather(device, light, frames, channels=channels).get()
        whole = environment.gather(device, light, frames, channels=channels, splat_hard=True).get()
        close(device, soft, np.broadcast_to(np.arange(1.0, channels + 1)[:, None], soft.shape))
        above = np.einsum("pi,li->pl", frames[:, 2], light.hard[:, :3]) > 0
        energy = (whole - soft).sum(axis=2) * (2 * np.pi / 4**levels)
        close(device, energy, above @ light.hard[:, 3 : 3 + channels], slack=10)


def light_and_visibility(device: Device) -> None:
    image = np.random.default_rng(0).uniform(0.1, 3, (8, 16, 3)).astype(np.float32)
    frames = cases.frames(POINTS)
    for levels, rays, keep, channels in ((1, 1, 1, 3), (3, 2, 2, 3), (4, 3, 4, 1), (4, 4, 1, 3)):
        points = POINTS if levels < 4 else 3
        light, turned = Environment(image).split(levels, "off"), frames[:points]
        seen = cases.visibility(points, rays)
        bits = cases.pack_bits(seen)
        soft = environment.gather(device, light, turned, channels=channels)
        visible = np.repeat(seen, 4 ** (levels - rays), axis=1)[:, None]
        expected = reference.haar(soft.get() * visible)[..., : 4**keep]
        close(device, masked.reduce_samples(device, soft, bits, rays, keep).get(), expected)
        coefficients = haar.forward(device, soft)
        close(device, masked.reduce_coefficients(device, coefficients, bits, rays, keep).get(), expected)
        if rays == levels:
            in_place = masked.reduce_in_place(device, coefficients, bits).get()[..., : 4**keep]
            close(device, in_place, expected)
        for method in ("pixel", "tree"):
            settings = Settings(levels=levels, rays=rays, keep=keep, method=method)
            got = collapse.reduced_coefficients(device, light, bits, turned, settings, channels).get()
            close(device, got, expected)
        sums = device.empty((points, quadtree.n_squares(levels + 1)), np.uint32)
        rows = device.array(np.arange(points), np.int32)
        settings = Settings(levels=levels, rays=rays, keep=levels)
        collapse.packed_sums(device, light, bits, turned, settings, channels, rows, sums, 1024.0)
        means = np.broadcast_to((soft.get() * visible).mean(axis=2), (points, 3))
        step = 2 * pyramid.ROUNDING * means.max(axis=1, keepdims=True)
        assert (np.abs(pyramid.unpack(sums.get()[:, 0], 1024.0) - means) <= step).all()


def all_materials() -> list[Material]:
    specs = (
        "lambert:albedo=0.8/0.2/0.1",
        "ggx:alpha=0.3,eta=0.18/0.42/1.37,k=3.42/2.35/1.77",
        "ggx:alpha=0.3,f0=0.04,kd=0.5/0.3/0.1",
        "blinn:exponent=20,ks=0.5/0.4/0.3,kd=0.1",
    )
    values = np.random.default_rng(6).uniform(0.1, 1, (7, 5, 3))
    table = from_table(values, np.linspace(0.0, 1.5, 7), np.linspace(0.1, 1.4, 5))
    rng = np.random.default_rng(7)
    nodes, valid = np.linspace(0.1, 1.5, 4), rng.random((4, 4, 5)) > 0.1
    measured = Measured.make(rng.uniform(0.1, 1, (4, 4, 5, 3)), nodes, nodes, valid)
    return [*map(Material.parse, specs), table, measured.material()]


def directions(count: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(count)
    z, phi = rng.uniform(0.2, 1, count), rng.uniform(0, 2 * np.pi, count)
    return np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], axis=1)


def reflectance(device: Device) -> None:
    incident, outgoing = directions(POINTS), directions(POINTS + 1)[1:]
    chosen = all_materials()
    materials = Materials(device, chosen)
    views = outgoing[:3]
    for levels, sub in ((1, 1), (3, 1)):
        slices = materials.slices(views, levels, sub).get()
        fine = hemisphere.directions(levels + sub).astype(np.float64)
        for material, own in zip(chosen, slices, strict=True):
            f = reference.brdf(material.reference(), fine[None, :, :3], views[:, None])
            cells = (f * fine[:, 3:]).reshape(len(views), 4**levels, 4**sub, 3).mean(axis=2)
            close(device, own, reference.haar(cells.transpose(0, 2, 1)), slack=10)
    for index, material in enumerate(chosen):
        expected = reference.brdf(material.reference(), incident, outgoing)
        close(device, materials.evaluate(index, incident, outgoing), expected, slack=10)


def radiance(device: Device) -> None:
    rng = np.random.default_rng(2)
    for keep, channels, slice_channels, n_slices in ((1, 1, 1, 1), (3, 3, 3, 2), (3, 3, 1, 4), (2, 1, 3, 2)):
        reduced = rng.uniform(0.1, 1, (POINTS, channels, 4**keep))
        slices = rng.uniform(0.1, 1, (7, slice_channels, 4**keep))
        index = rng.integers(0, 7, (POINTS, n_slices)).astype(np.int32)
        weight = rng.uniform(0.1, 1, (POINTS, n_slices))
        both = np.broadcast_to(reduced, (POINTS, 3, 4**keep)), np.broadcast_to(slices, (7, 3, 4**keep))
        terms = np.einsum("pcj,pkcj,pk->pc", both[0], both[1][index], weight)
        expected = np.concatenate([2 * np.pi / 4**keep * terms, np.zeros((POINTS, 1))], axis=1)
        coefficients, stored = device.array(reduced), device.array(slices)
        arguments = (device, coefficients, stored, index, weight, keep)
        out = shade.soft_radiance(*arguments)
        close(device, out.get(), expected)
        close(device, shade.soft_radiance(*arguments, out=out).get(), 2 * expected)
        for lanes in (4, 64):
            built = device.kernels(
                "shade.cl", KEEP=keep, CHANNELS=channels, SLICE_CHANNELS=slice_channels, N_SLICES=n_slices,
                GROUP=lanes,
            )  # fmt: skip
            inputs = coefficients, stored, device.array(index, np.int32), device.array(weight), out
            scale = 2 * np.pi / 4**keep
            device.launch(built["inner_product"], lanes, lanes, *inputs, scale, 0, y=POINTS)
            close(device, out.get(), expected)
            device.launch(built["inner_product_plain"], POINTS, lanes, *inputs, scale, POINTS)
            close(device, out.get(), expected)


def hard_light(device: Device) -> None:
    chosen = all_materials()
    light = sky(1, hard=True)
    frames = cases.frames(POINTS).astype(np.float64)
    views = directions(POINTS)
    material = (np.arange(POINTS) % len(chosen)).astype(np.int32)
    seen = np.random.default_rng(3).uniform(size=(POINTS, 3)) < 0.7
    words = (seen @ np.array([1, 2, 4])).astype(np.uint32)[:, None]
    expected = np.ones((POINTS, 4))
    for p in range(POINTS):
        local = light.hard[:, :3] @ frames[p].T
        f = reference.brdf(chosen[material[p]].reference(), local, views[p])
        expected[p, :3] += (f * np.maximum(local[:, 2:], 0) * light.hard[:, 3:] * seen[p][:, None]).sum(
            axis=0
        )
    out = device.array(np.ones((POINTS, 4)))
    materials = Materials(device, chosen)
    shade.add_hard_radiance(device, materials, light, words, material, frames, views, out)
    close(device, out.get(), expected, slack=10)


def editing(device: Device) -> None:
    """Packed parent sums and radiance over cuts, the fast kernel against its plain twin."""
    rng = np.random.default_rng(4)
    chosen = all_materials()
    materials = Materials(device, chosen)
    for levels, channels in ((1, 3), (2, 1), (4, 3)):
        points = 5
        samples = rng.uniform(0.1, 1, (points, channels, 4**levels))
        sums = device.array(np.zeros((points, quadtree.n_squares(levels + 1))), np.uint32)
        pyramid.pack(
            device, device.array(samples), device.array(np.arange(points)[::-1], np.int32), sums, 1024.0
        )
        means = pyramid.unpack(sums.get()[::-1], 1024.0)[:, 0]
        expected = np.broadcast_to(samples.mean(axis=2), (points, 3))
        assert np.abs(means / expected - 1).max() < 2 * pyramid.ROUNDING
        own = cut.whole(levels)
        leaves = Leaves(device, Squares(levels), [own] * len(chosen))
        wanted = device.array(rng.integers(0, points, POINTS), np.int32)
        material = device.array(np.arange(points) % len(chosen), np.int32)
        views = device.empty((POINTS, 4))
        defines = {"LEVELS": levels, "SIDE": cut.SIDE, "KINDS": materials.mask}
        built = device.kernels("cut.cl", GROUP=64, **defines)
        device.launch(
            built["local_views"], POINTS, 64, device.array(rng.uniform(-1, 1, (points, 3))),
            device.array(cases.frames(points)), wanted, 3.0, 4.0, 5.0, views, POINTS,
        )  # fmt: skip
        inputs = (
            *materials.arguments, material, *leaves.arguments, sums, wanted, views,
        )  # fmt: skip
        fast, plain = device.empty((POINTS, 4)), device.empty((POINTS, 4))
        small = device.kernels("cut.cl", GROUP=16, **defines)
        device.launch(small["shade_cut"], 16, 16, *inputs, fast, 1 / 1024.0, 0, y=POINTS)
        device.launch(built["shade_cut_plain"], POINTS, 64, *inputs, plain, 1 / 1024.0, POINTS)
        close(device, fast.get(), plain.get().astype(np.float64))


def hard_light_kept(device: Device) -> None:
    """A tree's energies and radiance over its leaves, which is that of the samples."""
    chosen, light, points = all_materials(), sky(1, hard=True), 5
    materials, rng = Materials(device, chosen), np.random.default_rng(5)
    frames, views = cases.frames(points), directions(points)
    material = (np.arange(points) % len(chosen)).astype(np.int32)
    kept = HardSums(device, light.hard, 1.0, points)
    seen = rng.uniform(size=(points, 3)) < 0.7
    kept.collapse((seen @ np.array([1, 2, 4])).astype(np.uint32)[:, None], np.arange(points, dtype=np.int32))
    expected = np.zeros((points, 4))
    for p in range(points):
        local = kept.samples[:, :3] @ frames[p].astype(np.float64).T
        f = reference.brdf(chosen[material[p]].reference(), local, views[p])
        terms = f * np.maximum(local[:, 2:], 0) * kept.samples[:, 3:] * seen[p][:, None]
        expected[p, :3] = terms.sum(axis=0)
    out, padded = device.array(np.zeros((points, 4))), np.concatenate([views, np.zeros((points, 1))], axis=1)
    kept.add_radiance(
        materials, kept.lists(chosen, 0.0), device.array(np.arange(points), np.int32),
        device.array(material, np.int32), device.array(frames), device.array(padded), out,
    )  # fmt: skip
    got = out.get()
    # Energies are kept to a step of their largest channel.
    assert (np.abs(got - expected) <= 2 * pyramid.ROUNDING * expected.max(axis=1, keepdims=True)).all()


def bivariate(device: Device) -> None:
    """W_v against its adjoint and that one's twin, hard light too, and a local edit against a rebuild."""
    rng, h, d = np.random.default_rng(8), np.linspace(0.0, 1.5, 7), np.linspace(0.1, 1.4, 5)
    for levels, channels in ((1, 1), (2, 3)):
        operator = SliceOperator(device, h, d, levels, channels, 1)
        x, g = rng.uniform(0.1, 1, (7, 5, channels)), rng.uniform(0.1, 1, (POINTS, channels, 4**levels))
        views = directions(POINTS)
        forward = operator.forward(x, views).get().astype(np.float64)
        close(device, (x * operator.adjoint(g, views)).sum(), (forward * g).sum(), slack=10)
        samples, rows = haar.inverse(device, device.array(g)), (operator.rows(POINTS), operator.rows(POINTS))
        operator.add_soft(rows[0], samples, operator.outgoing(views))
        twin = device.kernels("bivariate.cl", LEVELS=levels, SUB=1, CHANNELS=channels, KINDS=16, GROUP=64)
        device.launch(
            twin["table_adjoint_plain"], 35, 64, operator.nodes, 7, 5, operator.directions,
            device.array(operator.outgoing(views)), samples, 1, 1.0, rows[1], y=POINTS,
        )  # fmt: skip
        close(device, rows[0].get(), rows[1].get().astype(np.float64), slack=10)
        light, frames = sky(1, hard=True), cases.frames(POINTS)
        hard = operator.rows(POINTS)
        operator.add_hard(hard, light, np.full((POINTS, 1), 7, np.uint32), frames, operator.outgoing(views))
        local = np.einsum("pij,lj->pli", frames.astype(np.float64), light.hard[:, :3])
        expected = np.maximum(local[..., 2], 0) @ light.hard[:, 3 : 3 + channels]
        close(device, hard.get().reshape(POINTS, 35, channels).sum(axis=1), expected, slack=10)
    table = Bivariate.make(rng.uniform(0.1, 1, (7, 5, 3)), h, d)
    kept = TableSlices(device, table, directions(5), 2, 1)
    kept.edit(slice(2, 4), slice(1, 2), 5.0)
    whole = Materials(device, [Bivariate.make(kept.values, h, d).material()]).slices(directions(5), 2, 1)
    assert (kept.coefficients.get() == whole.get()[0]).all()


def limits(device: Device) -> None:
    """Copies, and chains of multiply-adds."""
    values = np.random.default_rng(0).normal(size=2 * 64).astype(device.dtype)
    kernels, source = device.kernels("limits.cl", GROUP=64, ROW=64), device.array(values)
    for name, count, group in (("copy_items", 32, 64), ("copy_rows", 2, 1), ("copy_rows_stream", 2, 1)):
        target = device.array(np.zeros_like(values))
        device.launch(kernels[name], count, group, source, target, count)
        assert (target.get() == values).all(), name
    kernel = device.kernels("limits.cl", GROUP=1, ROW=64, ACCUMULATORS=2)["multiply_adds"]
    out = device.empty((3,))
    device.launch(kernel, 3, 1, out, 1.0, 2.0, 5)
    close(device, out.get(), 16 * (2 * np.arange(3) + 1 + 2 * 5 * 2.0))


def fixed_views(device: Device) -> None:
    """Transport of pixels, its product with many lights, hard light on pixels."""
    chosen, rng = all_materials(), np.random.default_rng(8)
    counts = np.array([1, 16, 3] * 3)
    pixels, total = Pixels.of(np.repeat(np.arange(len(counts)), counts)), counts.sum()
    material = (np.arange(total) % len(chosen)).astype(np.int32)
    frames, views = cases.frames(total).astype(np.float64), directions(total)
    outgoing = np.concatenate([views, np.zeros((total, 1))], axis=1)
    bits = rng.integers(0, 2**32, (len(pixels), 1), dtype=np.uint32)
    tile = pixel_transport.Tile(
        device.array(pixels.first, np.int32), device.array(pixels.phase, np.int32), device.array(frames),
        device.array(outgoing), bits, device.array(bits, np.uint32),
    )  # fmt: skip
    materials, kinds = Materials(device, chosen), device.array(material, np.int32)
    world = sphere.centres(2)[:, :3].astype(np.float64)
    expected = np.zeros((3, len(pixels), 32))
    for pixel in range(len(pixels)):
        point = pixels.point(np.full(32, pixel), cell_turns(np.arange(32)))
        for d in range(32):
            local = frames[point[d]] @ world[d]
            if bits[pixel, 0] >> np.uint32(d) & 1 and local[2] > 0:
                f = reference.brdf(
                    chosen[material[point[d]]].reference(), local[None], views[point[d]][None]
                )[0]
                expected[:, pixel, d] = f * local[2] * 2 * np.pi / 16
    cells = device.array(np.arange(32), np.int32)
    grids = pixel_transport.Grids(2, 2, 2)
    rows = pixel_transport.transport(device, materials, kinds, tile, cells, grids, 3)
    close(device, rows.get(), expected, slack=10)
    lights = rng.uniform(size=(5, 32, 3))
    panels = device.array(pixel_transport.panels(lights))
    wanted = np.zeros((len(pixels), 3, pixel_transport.PANEL))
    wanted[..., :5] = np.einsum("cpk,ekc->pce", rows.get().astype(np.float64), lights)
    got = pixel_transport.product(device, rows, panels, cells)
    close(device, got.get(), wanted)
    twin = device.kernels("pixel_product.cl", CHANNELS=3, PANEL=pixel_transport.PANEL)["pixel_product_plain"]
    plain = device.empty(wanted.shape)
    device.launch(
        twin, 3 * pixel_transport.PANEL, 16, rows, panels, 32, cells, 32, len(pixels), 1, plain, y=len(pixels)
    )
    close(device, plain.get(), wanted)
    hard, light = sky(1, hard=True).hard, np.zeros((3, 2, 4))
    light[:, 0, :3], light[:, 1, :3] = hard[:, :3], hard[:, 3:]
    corners = np.array([[-1] * 4, [3, 3, 7, 7], [-1] * 4])
    kernel = device.kernels("pixel_lights.cl", KINDS=materials.mask, GROUP=64)["pixel_lights"]
    device.launch(
        kernel, len(pixels), 64, *materials.arguments, kinds, device.array(light),
        device.array(np.arange(3), np.int32), device.array(np.array([0, 3]), np.int32), tile.device_bits, 1,
        tile.device_bits, 1, device.array(corners, np.int32), device.array(np.full((3, 4), 0.25)), tile.frames,
        tile.views, tile.first, tile.phase, len(pixels), pixel_transport.PANEL, plain,
    )  # fmt: skip
    for pixel in range(len(pixels)):
        for number, sample in enumerate(hard):
            own = corners[number, 0] < 0
            for bit, turn in (
                [(number, number)] if own else zip(corners[number], cell_turns(corners[number]), strict=True)
            ):
                point = int(pixels.point(np.array(pixel), np.array(turn)))
                local = frames[point] @ sample[:3]
                if bits[pixel, 0] >> np.uint32(bit) & 1 and local[2] > 0:
                    f = reference.brdf(chosen[material[point]].reference(), local[None], views[point][None])[
                        0
                    ]
                    wanted[pixel, :, 0] += (1.0 if own else 0.25) * f * local[2] * sample[3:]
    close(device, plain.get(), wanted, slack=10)


TASKS: tuple[Callable[[Device], None], ...] = (
    haar_both_ways, triple_products, visibility, environment_gathered_and_splat, light_and_visibility, reflectance,
    radiance, hard_light, editing, hard_light_kept, bivariate, fixed_views, limits,
)  # fmt: skip


def main() -> None:
    single = Watched("float32")
    double = "cl_khr_fp64" in single.handle.extensions
    for device in [single, *([Watched("mixed"), Watched("float64")] if double else [])]:
        for wide in (False, True) if device.takes_vectors else (False,):
            with cases.forms(wide):
                for task in TASKS:
                    try:
                        task(device)
                    except AssertionError as error:
                        where = f"{device.name}, {device.precision}, {task.__name__}, {wide=}"
                        raise SystemExit(f"{where}: {error}") from error
        wanted = kernels_of_the_sources(device.takes_vectors)
        missing = [name for name in wanted if name not in device.launched]
        if missing:
            raise SystemExit(f"these kernels were never launched: {', '.join(missing)}")
        print(
            f"{device.name}, {device.precision}: {len(wanted)} kernels, {sum(device.launched.values())} launches"
        )


if __name__ == "__main__":
    main()
