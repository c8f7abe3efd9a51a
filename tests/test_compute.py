"""The compute floor: choice of device, defines, sources, build errors, memory, chunks; importing is free."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cases
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import prtcl.compute.device as device_module
from prtcl.compute import choice, chunks, source, vendors
from prtcl.compute.choice import Seen
from prtcl.compute.defines import Defines
from prtcl.compute.device import Device
from prtcl.compute.source import kernel_folder
from prtcl.errors import DeviceError, InputError, KernelBuildError, PrtclError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.transport.pipeline import Pipeline, Points
from prtcl.transport.settings import Settings, choose


def fake(spec: str, platform: str, name: str, kind: str) -> Seen:
    p, d = map(int, spec.split(":"))
    return Seen(p, d, platform, name, kind, "1.0", 1 << 30, 1 << 28, 4, True, object())


CPU = fake("0:0", "Portable Computing Language", "pthread-EPYC", "CPU")
OTHER_CPU = fake("0:1", "Portable Computing Language", "pthread-small", "CPU")
ACCELERATOR = fake("1:0", "Intel(R) FPGA", "Emulation Device", "ACCELERATOR")
GPU = fake("2:0", "NVIDIA CUDA", "H100", "GPU")
GPU_2 = fake("2:1", "NVIDIA CUDA", "A100", "GPU")
CUSTOM = fake("3:0", "Strange", "DSP", "OTHER")


# --- choice -------------------------------------------------------------------------------------------------


@pytest.fixture
def no_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(choice.VARIABLE, raising=False)


@pytest.mark.parametrize(
    ("seen", "expected", "reason"),
    [
        ([CPU, ACCELERATOR, GPU, GPU_2], GPU, "first GPU found"),
        ([CPU, ACCELERATOR], ACCELERATOR, "first ACCELERATOR found; no GPU was found"),
        ([CPU, OTHER_CPU], CPU, "first CPU found; no GPU was found"),
        ([CUSTOM], CUSTOM, "first OTHER found; no GPU was found"),
    ],
)
def test_priorities(no_variable: None, seen: list[Seen], expected: Seen, reason: str) -> None:
    assert choice.choose(None, seen) == (expected, reason)


ALL = [CPU, OTHER_CPU, ACCELERATOR, GPU, GPU_2]


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("0", CPU), ("0:1", OTHER_CPU), ("2:1", GPU_2), ("nvidia", GPU), ("NVIDIA:a100", GPU_2),
        ("portable:1", OTHER_CPU), ("0:SMALL", OTHER_CPU), ("fpga", ACCELERATOR),
        ("cuda:0", GPU), (":a100", GPU_2), ("2:", GPU),
    ],
)  # fmt: skip
def test_spec_names_indices_and_parts(no_variable: None, spec: str, expected: Seen) -> None:
    assert choice.choose(spec, ALL) == (expected, f"asked for by --device {spec}")


@pytest.mark.parametrize("device", ALL, ids=lambda d: d.spec)
def test_a_devices_own_spec_finds_it(no_variable: None, device: Seen) -> None:
    assert choice.choose(device.spec, ALL)[0] is device


def test_variable_yields_to_an_argument(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(choice.VARIABLE, "portable:small")
    assert choice.choose(None, ALL) == (OTHER_CPU, "asked for by PRTCL_DEVICE portable:small")
    assert choice.choose("nvidia", ALL)[0] is GPU
    monkeypatch.setenv(choice.VARIABLE, "")
    assert choice.choose(None, ALL)[0] is GPU


@pytest.mark.parametrize("spec", ["7", "0:2", "radeon", "nvidia:h200", "portable:h100"])
def test_what_matches_nothing_lists_what_there_is(no_variable: None, spec: str) -> None:
    with pytest.raises(InputError) as caught:
        choice.choose(spec, ALL)
    message = str(caught.value)
    assert message.startswith(f"--device {spec}: no OpenCL device matches")
    assert "2:1 NVIDIA CUDA / A100" in message
    assert len(message.splitlines()) == 2


def test_bad_variable_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(choice.VARIABLE, "radeon")
    with pytest.raises(InputError, match="PRTCL_DEVICE radeon: no OpenCL device"):
        choice.choose(None, ALL)


class FakeDevice:
    name, driver_version, extensions = " Fake One ", " 3.1 ", "cl_khr_fp64"
    version = "OpenCL 3.0 Fake "
    global_mem_size, max_mem_alloc_size, max_compute_units, double_fp_config = 1 << 30, 1 << 28, 2, 63

    def __init__(self, kind: int) -> None:
        self.type = kind


def fake_platform(name: str, handles: list[FakeDevice] | Exception) -> SimpleNamespace:
    def get_devices() -> list[FakeDevice]:
        if isinstance(handles, Exception):
            raise handles
        return handles

    return SimpleNamespace(name=name, get_devices=get_devices)


def test_platforms_without_devices_are_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    cl = pytest.importorskip("pyopencl")
    platforms = [
        fake_platform("Clover", cl.RuntimeError("clGetDeviceIDs failed: DEVICE_NOT_FOUND")),
        fake_platform("rusticl", []),
        fake_platform("Good ", [FakeDevice(cl.device_type.CPU), FakeDevice(cl.device_type.GPU)]),
    ]
    monkeypatch.setattr(cl, "get_platforms", lambda: platforms)
    seen = choice.devices()
    assert [(d.spec, d.platform, d.name, d.kind, d.driver) for d in seen] == [
        ("2:0", "Good", "Fake One", "CPU", "3.1"),
        ("2:1", "Good", "Fake One", "GPU", "3.1"),
    ]
    assert seen[0].float64
    monkeypatch.setattr(FakeDevice, "extensions", "")
    assert not choice.devices()[0].float64


POCL = "OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-"


@pytest.mark.parametrize(
    ("version", "usable"),
    [(POCL + "generic", False), (POCL + "znver3", True), ("OpenCL 3.0 generic", True),
     (POCL.replace("x86_64", "aarch64") + "generic", True)],
)  # fmt: skip
def test_a_pocl_older_than_the_cpu(
    no_variable: None, monkeypatch: pytest.MonkeyPatch, version: str, usable: bool
) -> None:
    """It lists a device, but every build would fail: "unknown target CPU 'generic'"."""
    cl = pytest.importorskip("pyopencl")
    old = FakeDevice(cl.device_type.CPU)
    old.version = version
    monkeypatch.setattr(cl, "get_platforms", lambda: [fake_platform("Portable Computing Language", [old])])
    seen = choice.devices()
    assert bool(seen[0].flaw) != usable
    if usable:
        assert choice.choose(None, seen)[0] is seen[0]
        return
    for spec in (None, "portable"):
        with pytest.raises(DeviceError, match="older than this CPU") as caught:
            choice.choose(spec, seen)
        assert "pip install 'prtcl[intel]'" in str(caught.value)
    assert choice.choose(None, [*seen, OTHER_CPU])[0] is OTHER_CPU


def test_intels_wheel_is_shown_to_the_loader(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    library, system = tmp_path / vendors.LIBRARY, tmp_path / "vendors"
    system.mkdir()
    (system / "gpu.icd").write_text("libgpu.so\n")
    monkeypatch.setattr(vendors, "intel_library", lambda: library)
    monkeypatch.setattr(vendors, "SYSTEM", system)
    monkeypatch.setenv("OCL_ICD_VENDORS", "mine")
    vendors.reveal()
    assert vendors.os.environ["OCL_ICD_VENDORS"] == "mine", "a user's own choice stands"
    monkeypatch.setenv("OCL_ICD_VENDORS", "")
    vendors.reveal()
    shown = Path(vendors.os.environ["OCL_ICD_VENDORS"])
    assert {p.name: p.read_text().strip() for p in shown.iterdir()} == {
        "gpu.icd": "libgpu.so", "prtcl-intel.icd": str(library)
    }  # fmt: skip


def test_only_empty_platforms(monkeypatch: pytest.MonkeyPatch) -> None:
    cl = pytest.importorskip("pyopencl")
    monkeypatch.setattr(
        cl, "get_platforms", lambda: [fake_platform("rusticl", []), fake_platform("Clover", [])]
    )
    with pytest.raises(DeviceError) as caught:
        choice.devices()
    assert "rusticl, Clover" in str(caught.value)
    assert "pip install 'prtcl[pocl]'" in str(caught.value)


def test_no_platform_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    cl = pytest.importorskip("pyopencl")

    def none() -> Any:
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", none)
    with pytest.raises(
        DeviceError, match="no OpenCL platform was found on this machine\ninstall one"
    ) as caught:
        choice.devices()
    assert caught.value.exit_status == 1


# --- defines ------------------------------------------------------------------------------------------------


def test_defines_sort_and_format() -> None:
    assert Defines(REAL="float", LEVELS=5, ON=True, X=0.1).options == [
        "-DLEVELS=5", "-DON=1", f"-DREAL={'float'}", "-DX=0x1.999999999999ap-4",
    ]  # fmt: skip
    assert repr(Defines(B=2, A=-1)) == "-DA=-1 -DB=2"


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_floats_lose_no_digit(value: float) -> None:
    (option,) = Defines(X=value).options
    assert float.fromhex(option.removeprefix("-DX=")) == value


def test_defines_are_equal_and_hash_by_value() -> None:
    assert Defines(A=1, B=2) == Defines(B=2, A=1)
    assert hash(Defines(A=1, B=2)) == hash(Defines(B=2, A=1))
    assert Defines(A=1) != Defines(A=2)
    assert Defines(A=1) != "A=1"


@pytest.mark.parametrize("name", ["lower", "1A", "A B", "A-B", ""])
def test_define_names_are_checked(name: str) -> None:
    with pytest.raises(ValueError, match="expected an UPPER_CASE name"):
        Defines(**{name: 1})


@pytest.mark.parametrize("value", ["two words", "a;b", "", "1x", None, [1], "-O0"])
def test_define_values_are_checked(value: Any) -> None:
    with pytest.raises(ValueError, match="define X: expected a number or one C word"):
        Defines(X=value)


# --- sources ------------------------------------------------------------------------------------------------

KERNELS = sorted(path.name for path in source.kernel_folder().glob("*.cl*"))


@pytest.mark.parametrize("name", KERNELS)
def test_line_markers_are_true(name: str) -> None:
    """Every line of an expanded source stands where its marker says; nothing is there twice or left out."""
    files: dict[str, list[str]] = {}
    seen: dict[str, list[int]] = {}
    file, number = "", 0
    for line in source.expand.__wrapped__(name).splitlines():
        marker = re.match(r'#line (\d+) "([^"]+)"$', line)
        if marker:
            number, file = int(marker[1]), marker[2]
            files.setdefault(file, (source.kernel_folder() / file).read_text(encoding="utf-8").splitlines())
            continue
        original = files[file][number - 1]
        assert line == original or (line == "" and "#include" in original)
        seen.setdefault(file, []).append(number)
        number += 1
    assert name in seen
    for found, numbers in seen.items():
        assert len(numbers) == len(set(numbers)), f"{found} is there twice"
        missing = set(range(1, len(files[found]) + 1)) - set(numbers)
        assert all("#include" in files[found][n - 1] for n in missing)


def test_includes_expand_once_and_in_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.cl").write_text('first\n#include "b.clh"\n#include "c.clh"\nlast\n')
    (tmp_path / "b.clh").write_text('  #include "c.clh"\nb\n')
    (tmp_path / "c.clh").write_text("c\n")
    monkeypatch.setattr(source, "kernel_folder", lambda: tmp_path)
    text = source.expand.__wrapped__("a.cl")
    assert text == (
        '#line 1 "a.cl"\nfirst\n#line 1 "b.clh"\n#line 1 "c.clh"\nc\n#line 2 "b.clh"\nb\n#line 3 "a.cl"\n'
        '\nlast\n'
    )  # fmt: skip


def test_missing_kernels_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "__file__", str(tmp_path / "prtcl" / "compute" / "source.py"))
    with pytest.raises(PrtclError, match=r"kernels/\*\.cl\) are missing\nreinstall prtcl"):
        source.kernel_folder()
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels" / "common.clh").touch()
    assert source.kernel_folder() == (tmp_path / "kernels").resolve()


# --- building -----------------------------------------------------------------------------------------------


def test_build_error_says_everything(device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = '#line 41 "broken.cl"\nkernel void f(global REAL *x)\n{\n    x[0] = undeclared_name;\n}\n'
    monkeypatch.setattr(device_module, "expand", lambda name: broken)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(KernelBuildError) as caught:
        device.kernels("broken.cl", LEVELS=5)
    message = str(caught.value)
    assert message.startswith(f"broken.cl: does not build on {device.name} (driver ")
    assert "-DLEVELS=5" in message
    assert f"-DREAL={device.real}" in message
    assert "undeclared_name" in message
    (dumped,) = tmp_path.glob("prtcl-*.cl")
    assert str(dumped) in message
    assert dumped.read_text(encoding="utf-8") == broken
    assert caught.value.__cause__ is not None
    assert isinstance(caught.value, DeviceError)


@pytest.mark.parametrize("name", [n for n in KERNELS if n.endswith(".cl") and n != "haar_plain.cl"])
def test_missing_problem_constants_are_named(
    device: Device, name: str, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(KernelBuildError, match=r": pass -D [A-Z]+="):
        device.kernels(name)


def test_programs_are_built_once(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    first = device.kernels("haar.cl", DEPTH=1, GROUP=64)
    monkeypatch.setattr(device_module, "expand", lambda name: pytest.fail("built again"))
    assert device.kernels("haar.cl", GROUP=64, DEPTH=1) is first
    assert set(first) == {"haar_forward", "haar_inverse"}


# --- arrays and queues --------------------------------------------------------------------------------------


@pytest.fixture
def own_queue(device: Device) -> Iterator[Callable[..., Any]]:
    """Make command queues of a caller's own contexts, which the fixture keeps alive (Intel's wants it)."""
    import pyopencl as cl

    alive = []

    def make(**options: Any) -> Any:
        alive.append(cl.Context([device.handle]))
        return cl.CommandQueue(alive[-1], **options)

    yield make


def test_arrays_of_two_contexts_do_not_mix(device: Device, own_queue: Any) -> None:
    with Device(queue=own_queue()) as other:
        foreign = other.array(np.ones(4))
        with pytest.raises(InputError) as caught:
            device.array(foreign, name="light")
        message = str(caught.value)
        assert message.startswith("light: a device array of another OpenCL context")
        assert message.count(device.name) == 2
        assert "copy it with .get() first" in message


def test_a_callers_queue_and_arrays_are_used_as_they_are(device: Device, own_queue: Any) -> None:
    import pyopencl.array as cla

    from prtcl.wavelet import haar

    queue = own_queue()
    with Device(queue=queue) as mine:
        assert mine.queue is queue
        assert mine.context == queue.context
        assert mine.reason == "the caller's queue"
        assert not mine.profile.enabled
        x = np.random.default_rng(1).normal(size=(5, 64)).astype(np.float32)
        theirs = cla.to_device(queue, x)
        assert mine.array(theirs) is theirs
        got = haar.forward(mine, theirs)
        assert got.queue is queue
        assert (got.get() == haar.forward(device, device.array(x)).get()).all()
        assert mine.profile.device_seconds() == {}
    assert (theirs.get() == x).all()  # closing releases nothing of the caller's


def test_out_of_order_queues_are_refused(device: Device, own_queue: Any) -> None:
    import pyopencl as cl

    try:
        queue = own_queue(properties=cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE)
    except cl.Error as error:
        pytest.skip(f"{device.name}: no out-of-order queues ({error})")
    with pytest.raises(InputError, match="queue: expected an in-order command queue"):
        Device(queue=queue)


def test_device_arrays_of_another_type_or_order_are_refused(device: Device) -> None:
    wrong = device.array(np.ones(4), np.int32)
    with pytest.raises(InputError, match="bits: expected a C-contiguous float32 device array, got int32"):
        device.array(wrong, name="bits")
    turned = device.array(np.ones((3, 4))).T
    with pytest.raises(InputError, match="light: expected a C-contiguous float32"):
        device.array(turned, name="light")


def test_host_arrays_are_converted(device: Device) -> None:
    x = np.arange(12.0).reshape(3, 4)
    assert (device.array(x.T).get() == x.T.astype(np.float32)).all()
    assert device.array([1, 2], np.int32).dtype == np.int32
    assert device.array(np.zeros((0, 3))).shape == (0, 3)


def test_constants_are_made_once(device: Device) -> None:
    made = []

    def make() -> Any:
        made.append(1)
        return np.arange(3.0)

    first = device.constant("test_constants_are_made_once", make)
    assert device.constant("test_constants_are_made_once", make) is first
    assert made == [1]


def test_precisions(device: Device, make_device: Any) -> None:
    with pytest.raises(InputError, match="precision: expected one of float32, mixed, float64, got 'half'"):
        Device(queue=device.queue, precision="half")
    assert device.dtype is np.float32
    assert (device.real, device.accumulator) == ("float", "float")
    mixed = make_device("mixed")
    assert mixed.dtype is np.float32
    assert (mixed.real, mixed.accumulator) == ("float", "double")


@pytest.mark.parametrize("precision", ["mixed", "float64"])
def test_precision_that_the_device_lacks(precision: str) -> None:
    """A device without cl_khr_fp64 is refused before anything is compiled."""
    cl = pytest.importorskip("pyopencl")
    handle = SimpleNamespace(name="Small GPU", extensions="cl_khr_fp16", type=cl.device_type.GPU)
    queue = SimpleNamespace(properties=0, context=object(), device=handle)
    with pytest.raises(DeviceError, match=f"Small GPU: precision {precision} needs float64"):
        Device(queue=queue, precision=precision)


def test_launch_of_nothing_is_nothing(device: Device) -> None:
    kernel = device.kernels("haar.cl", DEPTH=1, GROUP=64)["haar_forward"]
    assert device.launch(kernel, 0, 64) is None
    assert device.launch(kernel, 5, 64, y=0) is None


@pytest.mark.parametrize("method", ["pixel", "tree"])
def test_a_launch_of_more_rows_than_a_device_takes_goes_in_several(
    device: Device, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    """Everything from rays to radiance: each kernel finds its row, and no bit changes."""
    tracer, points = quad_and_points(67)
    settings = Settings(levels=3, rays=3, keep=3, views=9, method=method)
    materials = [Material.parse("lambert:albedo=0.5/0.4/0.3"), Material.parse("ggx:alpha=0.3,f0=0.1")]
    image = np.exp(np.random.default_rng(1).normal(size=(16, 32, 3))).astype(np.float32)
    rows: list[int] = []
    add = device.profile.add

    def watch(stage: str, event: Any) -> None:
        rows.append(1)
        add(stage, event)

    def run() -> Any:
        rows.clear()
        return Pipeline(device, Environment(image), materials, settings).radiance(tracer, points)

    monkeypatch.setattr(device.profile, "add", watch)
    with cases.forms(wide=False):  # those that launch a row a point
        whole, launches = run(), len(rows)
        monkeypatch.setattr(device_module, "MAX_ROWS", 10)
        assert (run() == whole).all()
    assert len(rows) > launches + 6


def test_no_kernel_asks_for_its_group_in_y() -> None:
    """Launches in pieces have a global offset; group numbers start at zero in each."""
    for path in kernel_folder().glob("*.cl*"):
        assert "get_group_id(1)" not in path.read_text(encoding="utf-8"), path.name


def test_paste_puts_rows_where_they_belong(device: Device) -> None:
    target = device.array(np.zeros((6, 8)))
    source = device.array(np.arange(12.0).reshape(4, 3) + 1)
    device.paste(source[1:3], target, 3, 5)
    device.paste(source[:0], target, 0)
    device.paste(device.array(np.full((1, 8), 7.0)), target, 1)
    expected = np.zeros((6, 8))
    expected[3:5, 5:], expected[1] = [[4, 5, 6], [7, 8, 9]], 7
    assert (target.get() == expected).all()


def test_profile_counts_stages(device: Device) -> None:
    device.profile.reset()
    from prtcl.wavelet import haar

    haar.forward(device, device.array(np.ones((3, 16))))
    with device.profile.host("waiting"):
        pass
    device.profile.per_point("bits", 4)
    device.profile.per_point("bits", 2)  # the largest holds: of several pipelines, that is
    seconds = device.profile.device_seconds()
    assert set(seconds) == {"haar_forward"}
    assert seconds["haar_forward"] >= 0
    with device.profile.under("making"):
        haar.forward(device, device.array(np.ones((3, 16))))
    again = device.profile.device_seconds()
    assert again["haar_forward"] == seconds["haar_forward"] and set(again) == {"haar_forward", "making"}
    assert set(device.profile.host_seconds()) == {"waiting"}
    assert device.profile.bytes_per_point() == {"bits": 4}
    device.profile.reset()
    assert (
        device.profile.device_seconds()
        == device.profile.host_seconds()
        == device.profile.bytes_per_point()
        == {}
    )


# --- chunks -------------------------------------------------------------------------------------------------


def tiny(memory: int, largest: int) -> Any:
    return SimpleNamespace(name="Tiny", memory=memory, max_allocation=largest)


def test_chunks_fit_memory_and_the_largest_buffer() -> None:
    assert chunks.chunk_size(tiny(4000, 10**9), 100, 60) == 10  # a quarter of the memory
    assert chunks.chunk_size(tiny(10**9, 300), 100, 60) == 5  # the largest buffer
    assert chunks.chunk_size(tiny(10**9, 10**9), 100, 60, budget=250) == 2
    assert chunks.chunk_size(tiny(1 << 40, 1 << 40), 1 << 20, 1 << 20) == chunks.BUDGET >> 20


@pytest.mark.parametrize(
    ("memory", "largest", "budget"), [(300, 10**9, None), (10**9, 59, None), (10**9, 10**9, 99)]
)
def test_a_point_that_does_not_fit(memory: int, largest: int, budget: int | None) -> None:
    with pytest.raises(DeviceError, match=r"Tiny: one point needs 100 bytes \(60 in one buffer\)"):
        chunks.chunk_size(tiny(memory, largest), 100, 60, budget)


def test_caches_leave_room_to_grow() -> None:
    assert chunks.cache_bytes(tiny(8000, 10**9)) == 1000
    assert chunks.cache_bytes(tiny(8000, 10**9), 3) == 333
    assert chunks.cache_bytes(tiny(10**9, 160)) == 140


@given(count=st.integers(0, 200), size=st.integers(1, 250))
def test_chunks_cover_everything_once(count: int, size: int) -> None:
    parts = list(chunks.chunks(count, size))
    assert [i for part in parts for i in range(count)[part]] == list(range(count))
    assert all(0 < part.stop - part.start <= size for part in parts)


def quad_and_points(count: int) -> tuple[Tracer, Points]:
    """Points about a square that hides part of their sky."""
    corners = np.array([[-1, 1, -1], [1, 1, -1], [1, 1, 1], [-1, 1, 1]], dtype=np.float64)
    tracer = Tracer(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    rng = np.random.default_rng(3)
    frames = cases.frames(count)
    views = np.stack([np.sin(t := rng.uniform(0, 1.4, count)), 0 * t, np.cos(t)], axis=1).astype(np.float32)
    points = Points(
        origins=tracer.origins(rng.uniform(-1, 0.9, (count, 3)), frames[:, 2]),
        frames=frames, views=views, material=rng.integers(0, 2, count).astype(np.int32),
        grid=rng.integers(0, 3, count).astype(np.int32), polar=True,
    )  # fmt: skip
    return tracer, points


@pytest.mark.parametrize("method", ["pixel", "tree"])
def test_radiance_does_not_depend_on_the_chunks(device: Device, method: str) -> None:
    tracer, points = quad_and_points(67)
    image = np.exp(np.random.default_rng(1).normal(size=(16, 32, 3))).astype(np.float32)
    image[4, 9] = 3e4
    materials = [Material.parse("lambert:albedo=0.5/0.4/0.3"), Material.parse("ggx:alpha=0.3,f0=0.1")]
    settings = Settings(levels=4, rays=3, keep=4, views=9, method=method)

    def run(budget: int | None) -> tuple[Any, int]:
        pipeline = Pipeline(device, Environment(image), materials, settings, budget=budget)
        assert len(pipeline.light.hard)
        return pipeline.radiance(tracer, points), sum(pipeline.bytes_per_point().values())

    whole, per_point = run(None)
    assert np.isfinite(whole).all()
    assert whole.shape == (67, 3)
    assert whole.min() > 0
    for count in (1, 13):
        assert (run(count * per_point)[0] == whole).all()
    with pytest.raises(DeviceError, match="one point needs"):
        run(per_point - 1)


@pytest.mark.parametrize("polar", [True, False])
def test_radiance_does_not_depend_on_how_many_slices_fit(device: Device, polar: bool) -> None:
    """Materials whose slices exceed a buffer take more chunks; 4 slices are what a point of a square table needs."""
    tracer, points = quad_and_points(67)
    image = np.exp(np.random.default_rng(1).normal(size=(16, 32, 3))).astype(np.float32)
    materials = [Material.parse(f"ggx:alpha={0.2 + 0.1 * i},f0=0.1/0.2/0.3") for i in range(2)]
    settings = Settings(levels=4, rays=3, keep=4, views=9)

    def run(slices: int | None) -> Any:
        size = None if slices is None else slices * 3 * 4**4 * 4
        pipeline = Pipeline(device, Environment(image), materials, settings, polar=polar, slice_bytes=size)
        bits = pipeline.visibility(tracer, points)
        return pipeline.soft(tracer, points), pipeline.soft(tracer, points, bits)

    whole, _ = run(None)
    assert whole.min() > 0
    for slices in (4, 5, 11):
        assert all((one == whole).all() for one in run(slices))
    with pytest.raises(DeviceError, match="slices of one point need"):
        run(1)


def test_a_pipeline_makes_no_slice_before_a_point_needs_it(device: Device) -> None:
    """Two of 512 views of a mirror whose slices cost a second of a core for every ten or so."""
    tracer, points = quad_and_points(5)
    points = replace(
        points, views=np.broadcast_to(np.float32([0.6, 0, 0.8]), (5, 3)), material=0 * points.material
    )
    device.profile.reset()
    material = Material.parse("ggx:alpha=0.003,f0=1")
    pipeline = Pipeline(device, Environment.constant(), [material] * 48, choose(material)[0])
    assert "brdf_slices" not in device.profile.device_seconds()
    pipeline.radiance(tracer, points)
    array, _ = pipeline.slices.take(np.empty((0, 2), np.int64))
    assert array.shape[0] == 2


def test_radiance_from_given_bits_is_that_of_traced_ones(device: Device) -> None:
    tracer, points = quad_and_points(9)
    settings = Settings(levels=3, rays=3, keep=3, views=5)
    pipeline = Pipeline(
        device, Environment.constant(1.0), [Material.parse("lambert:albedo=0.5")] * 2, settings
    )
    bits = pipeline.visibility(tracer, points)
    done: list[int] = []
    given_bits = pipeline.radiance(tracer, points, bits, done.append)
    assert (given_bits == pipeline.radiance(tracer, points)).all()
    assert sum(done) == 9


# --- importing ----------------------------------------------------------------------------------------------


def test_importing_touches_no_opencl() -> None:
    """Every module of the package, in a fresh interpreter."""
    script = (
        "import importlib, pkgutil, sys, prtcl\n"
        "names = [m.name for m in pkgutil.walk_packages(prtcl.__path__, 'prtcl.')]\n"
        "[importlib.import_module(n) for n in names if not n.endswith('__main__') and '.kernels' not in n]\n"
        "assert 'prtcl.transport.pipeline' in sys.modules\n"
        "print('pyopencl' in sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=120
    )
    assert (done.stdout, done.stderr, done.returncode) == ("False\n", "", 0)
