"""Fixtures: every OpenCL device of the machine, and the shared data set.

`device` runs a test once a device. ``PRTCL_DEVICE`` picks one; without any the tests skip and say why, or
fail where ``PRTCL_REQUIRE_DEVICE=1`` (continuous integration sets it, so that nothing-ran is red).
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import pytest
from cases import Ran, Run
from hypothesis import settings

from prtcl.apps.cli import main
from prtcl.apps.demo_scene import build
from prtcl.compute import choice, tuning
from prtcl.compute.device import Device
from prtcl.errors import PrtclError
from prtcl.factors.environment import Environment
from prtcl.factors.sky import sun_sky
from prtcl.scene.mesh import Mesh

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# What was tuned on this machine is none of the tests' business.
os.environ.setdefault(tuning.VARIABLE, "")

settings.register_profile("prtcl", derandomize=True, deadline=None, database=None, max_examples=20)
settings.load_profile("prtcl")


@lru_cache(maxsize=1)
def opencl_devices() -> tuple[list[choice.Seen], str]:
    """The devices to test on, and why there is none."""
    try:
        seen = [device for device in choice.devices() if not device.flaw] or [choice.choose()[0]]
        if os.environ.get(choice.VARIABLE):
            seen = [choice.choose(None, seen)[0]]
    except (ImportError, PrtclError) as error:
        return [], f"no OpenCL device to test on: {error}"
    return seen, ""


def device_ids(seen: list[choice.Seen]) -> list[str]:
    """Names of devices; those that share one name get their SPEC too."""
    shared = Counter(device.name for device in seen)
    return [d.name if shared[d.name] == 1 else f"{d.name} {d.spec}" for d in seen]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "opencl_device" in metafunc.fixturenames:
        seen, reason = opencl_devices()
        metafunc.parametrize(
            "opencl_device",
            list(seen) if seen else [reason],
            ids=device_ids(seen) if seen else ["no device"],
            indirect=True,
            scope="session",
        )


@pytest.fixture(scope="session")
def opencl_device(request: pytest.FixtureRequest) -> choice.Seen:
    """One OpenCL device, as `prtcl.compute.choice` sees it."""
    if isinstance(request.param, choice.Seen):
        return request.param
    for variable in (choice.VARIABLE, "PRTCL_REQUIRE_DEVICE"):  # a device that was asked for must be there
        if os.environ.get(variable, "0") not in ("", "0"):
            pytest.fail(f"{request.param}\n{variable}={os.environ[variable]} demands one", pytrace=False)
    pytest.skip(request.param)


@pytest.fixture(scope="session")
def make_device(opencl_device: choice.Seen) -> Iterator[Callable[[str], Device]]:
    """A `Device` of a given precision, made once; the test skips where the device lacks float64."""
    made: dict[str, Device] = {}

    def make(precision: str) -> Device:
        if precision != "float32" and not opencl_device.float64:
            pytest.skip(f"{opencl_device.name}: no float64, which precision {precision} needs")
        if precision not in made:
            made[precision] = Device(opencl_device.spec, precision=precision)
        return made[precision]

    yield make
    for device in made.values():
        device.close()


@pytest.fixture(scope="session")
def device(make_device: Callable[[str], Device]) -> Device:
    """A float32 `Device`, one a device of the machine."""
    return make_device("float32")


@pytest.fixture(params=["float32", "mixed", "float64"])
def any_device(request: pytest.FixtureRequest, make_device: Callable[[str], Device]) -> Device:
    """A `Device` of each precision."""
    return make_device(request.param)


@pytest.fixture(scope="session")
def mesh() -> Mesh:
    """The demo's scene: five parts that shadow one another."""
    return build()


@pytest.fixture(scope="session")
def sky() -> Environment:
    """A small sky with a sun at 40 degrees."""
    return Environment(sun_sky(32, sun_elevation=40.0, sun_azimuth=130.0))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of shared meshes, environments and BRDFs, beside the checkout."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no {SHARED_DATA}")
    return SHARED_DATA


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """`main` in this process: its exit status and what it printed."""

    def call(*arguments: object) -> Ran:
        capsys.readouterr()
        try:
            status = main([str(argument) for argument in arguments])
        except SystemExit as end:  # argparse's way out
            status = int(end.code or 0)
        return Ran(status, *capsys.readouterr())

    return call
