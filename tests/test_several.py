"""Several devices on one job, and parts whose answers are fetched while the next is under way."""

from __future__ import annotations

import numpy as np
import pytest

from prtcl.compute.choice import Seen
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import vertex_points
from prtcl.scene.scene import Scene
from prtcl.transport.pipeline import Pipelines
from prtcl.transport.settings import Settings
from prtcl.transport.several import Several, shares

MATERIALS = [
    Material.parse(spec)
    for spec in (
        "lambert:albedo=0.5",
        "ggx:alpha=0.3,f0=0.9",
        "lambert",
        "lambert",
        "ggx:alpha=0.3,f0=0.04,kd=0.5",
    )
]
SETTINGS = [Settings(3, 3, 3, 8)] * 4 + [Settings(4, 3, 4, 8)]
CAMERA = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(24, 18))


@pytest.fixture(scope="module")
def tracer(mesh: Mesh) -> Tracer:
    return Tracer(mesh.vertices, mesh.faces)


def pipelines(device: Device, sky: Environment, budget: int | None = None) -> Pipelines:
    return Pipelines(device, sky, MATERIALS, SETTINGS, budget=budget)


@pytest.mark.parametrize("count", [0, 1, 2, 501])
def test_alike_devices_give_the_bytes_of_one(
    opencl_device: Seen, mesh: Mesh, sky: Environment, tracer: Tracer, count: int
) -> None:
    points = vertex_points(mesh, tracer, (3.0, 2.0, 5.0))[:count]
    one, other = Device(opencl_device.spec), Device(opencl_device.spec)
    wanted = pipelines(one, sky).radiance(tracer, points)
    several = Several([pipelines(one, sky), pipelines(other, sky)])
    got = several.radiance(tracer, points)
    np.testing.assert_array_equal(got, wanted)
    assert (
        count < 2 or {"inner_product"} <= other.profile.device_seconds().keys() or not other.profile.enabled
    )
    assert len(several.all) == 2 * 2 and len(several.light.hard) > 0
    # Rays that the devices leave out of what they trace beside each other.
    alone = pipelines(one, sky)
    alone.radiance(tracer, points)
    for name in ("rays", "horizon"):
        left, of = np.sum([own.tally[name] for own in several.all], axis=0)
        assert (left, of) == tuple(np.sum([own.tally[name] for own in alone.all], axis=0)) and 0 <= left <= of
        assert count == 0 or of > 0
    bits = np.full((count, 2), 0x0F0F0F0F, dtype=np.uint32)
    np.testing.assert_array_equal(
        several.soft(tracer, points, bits), pipelines(one, sky).soft(tracer, points, bits)
    )


def test_a_device_beside_the_host_gives_the_same_bytes(
    monkeypatch: pytest.MonkeyPatch, device: Device, mesh: Mesh, sky: Environment, tracer: Tracer
) -> None:
    """Of many parts each is fetched while the next is traced."""
    points = vertex_points(mesh, tracer, (3.0, 2.0, 5.0))[:301]
    wanted = pipelines(device, sky).soft(tracer, points)
    monkeypatch.setattr(Device, "beside_host", True)
    np.testing.assert_array_equal(pipelines(device, sky, budget=1 << 18).soft(tracer, points), wanted)


def test_shares_follow_cores_and_clock(monkeypatch: pytest.MonkeyPatch, device: Device) -> None:
    class Fake:
        compute_units, clock, is_cpu, precision = 2, 1000, True, "float32"

    fast, silent, gpu = Fake(), Fake(), Fake()
    fast.clock, silent.compute_units, gpu.is_cpu = 3000, 0, False
    np.testing.assert_allclose(shares([Fake(), fast]), [0.25, 0.75])  # type: ignore[list-item]
    np.testing.assert_allclose(shares([Fake(), gpu]), [1 / 9, 8 / 9])  # type: ignore[list-item]
    assert shares([silent]).tolist() == [1.0]  # type: ignore[list-item]
    assert device.compute_units > 0 and device.clock >= 0


def test_devices_of_two_precisions_are_refused(make_device, sky: Environment) -> None:  # type: ignore[no-untyped-def]
    both = [pipelines(make_device(precision), sky) for precision in ("float32", "float64")]
    with pytest.raises(InputError, match="devices: expected one precision for all, got float32, float64"):
        Several(both)


@pytest.mark.parametrize("points", ["pixel", "vertex"])
def test_a_scene_on_two_devices(opencl_device: Seen, mesh: Mesh, sky: Environment, points: str) -> None:
    images, named = [], ""
    for count in (1, 2):
        devices = [Device(opencl_device.spec) for _ in range(count)]
        scene = Scene(mesh, sky, MATERIALS, CAMERA, device=devices, levels=3, views=8)
        render = scene.render(samples=2, points=points)
        images.append(render.image)
        named = render.report["device"]
        assert {"environment_gather", "light_times_visibility"} & render.report["seconds"].keys()
    np.testing.assert_array_equal(*images)
    assert named == " + ".join([devices[0].name] * 2)


def test_a_scene_on_no_device_is_refused(mesh: Mesh, sky: Environment) -> None:
    with pytest.raises(InputError, match="device: expected a Device or several, got an empty list"):
        Scene(mesh, sky, device=[])


def test_what_is_fetched_is_what_was_there(device: Device) -> None:
    values = np.arange(60, dtype=np.float32).reshape(5, 12)
    array = device.array(values)
    waits = [device.fetch(array), device.fetch(array[1:3]), device.fetch(device.empty((0, 4)))]
    for wait, wanted in zip(waits, (values, values[1:3], np.empty((0, 4))), strict=True):
        np.testing.assert_array_equal(wait(), wanted)
        np.testing.assert_array_equal(wait(), wanted)
