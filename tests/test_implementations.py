"""One image and every kernel on each OpenCL implementation that is installed here, next to the one in use.

`.ci/opencl` shows a process one implementation and no other, so each runs in a process of its own. What is not
installed is skipped; where ``PRTCL_REQUIRE_IMPLEMENTATIONS=1`` (continuous integration sets it) Oclgrind and two of
PoCL, Intel's and rusticl must run.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl.compute.choice import VARIABLE, Seen

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
WRAPPER = ROOT / ".ci" / "opencl"
IMPLEMENTATIONS = ("pocl", "intel", "rusticl", "oclgrind")
METHODS = ("pixel", "tree")
LIMIT = 1e-4
"""Of the largest difference over the largest value, and of the RMSE over the mean; they are some 1e-7."""

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason=".ci/opencl is for Linux")


def installed(name: str) -> bool:
    """Whether `.ci/opencl NAME` would run without installing anything first."""
    if name == "pocl":
        import pyopencl

        linker = subprocess.run(["which", "gcc", "ld"], stdout=subprocess.DEVNULL, check=False)
        there = (Path(pyopencl.__file__).parent / ".libs" / "pocl.icd").exists() and linker.returncode == 0
        return there and usable(name)
    if name == "intel":
        return (ROOT / ".venv-intel").is_dir()
    if name == "oclgrind":
        return Path("/usr/lib/oclgrind/liboclgrind-rt-icd.so").exists()
    cache = subprocess.run(["/sbin/ldconfig", "-p"], capture_output=True, text=True, check=False)
    return "libRusticlOpenCL.so.1" in cache.stdout


@lru_cache
def usable(name: str) -> bool:
    """Whether its device can compile for this CPU: the wheel's PoCL is older than some (prtcl/compute/choice.py)."""
    command = ["bash", str(WRAPPER), name, sys.executable, "-m", "prtcl", "devices"]
    environment = {key: value for key, value in os.environ.items() if key != VARIABLE}
    return subprocess.run(command, capture_output=True, env=environment, check=False).returncode == 0


def need(name: str) -> None:
    """Skip what is not installed, or fail where it is required."""
    if installed(name):
        return
    reason = f"{name} is not installed, or does not know this CPU; `.ci/opencl {name} true` installs it"
    required = os.environ.get("PRTCL_REQUIRE_IMPLEMENTATIONS", "0") not in ("", "0")
    # Two of the three that compile for the CPU must be there, and Oclgrind, which simulates one.
    compilers = [other for other in ("pocl", "intel", "rusticl") if installed(other)]
    if required and (name == "oclgrind" or len(compilers) < 2):
        pytest.fail(f"{reason}\nPRTCL_REQUIRE_IMPLEMENTATIONS demands it", pytrace=False)
    pytest.skip(reason)


def run(where: str | Seen, script: str, *arguments: str) -> str:
    """Run one of the scripts beside this file on an implementation by name, or on a device in sight."""
    command = [sys.executable, str(TESTS / script), *arguments]
    environment = {**os.environ, "PYTHON": sys.executable}
    if isinstance(where, Seen):
        environment[VARIABLE] = where.spec
    else:
        command = ["bash", str(WRAPPER), where, *command]
        environment.pop(VARIABLE, None)  # it may name a device of another implementation
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False, timeout=900)
    assert done.returncode == 0, f"exit status {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def here(opencl_device: Seen, tmp_path_factory: pytest.TempPathFactory) -> dict[str, NDArray[np.float32]]:
    """The images on a device of the tests' own surroundings."""
    path = tmp_path_factory.mktemp("here") / "small.npz"
    run(opencl_device, "render_small.py", str(path))
    with np.load(path) as images:
        return {method: images[method] for method in METHODS}


@pytest.mark.parametrize("name", IMPLEMENTATIONS)
def test_same_image(name: str, here: dict[str, NDArray[np.float32]], tmp_path: Path) -> None:
    need(name)
    path = tmp_path / "small.npz"
    run(name, "render_small.py", str(path))
    with np.load(path) as images:
        device = str(images["device"])
        there = {method: images[method].astype(np.float64) for method in METHODS}
    for method in METHODS:
        a, b = here[method].astype(np.float64), there[method]
        assert a.shape == b.shape == (18, 24, 4)
        assert np.isfinite(a).all()
        assert np.isfinite(b).all()
        assert (a[..., 3] > 0).mean() > 0.5, "MISTRUSTED: the image is mostly empty"
        worst, rmse = differences(a[..., :3], b[..., :3])
        print(
            f"{device}, {method}: largest difference {worst:.2g} of the maximum, RMSE {rmse:.2g} of the mean"
        )
        assert max(worst, rmse) <= LIMIT
        assert (a[..., 3] == b[..., 3]).all(), "coverage comes from the host and cannot differ"


def test_every_kernel_here(opencl_device: Seen) -> None:
    print(run(opencl_device, "every_kernel.py"))


@pytest.mark.parametrize("name", [name for name in IMPLEMENTATIONS if name != "pocl"])
def test_every_kernel(name: str) -> None:
    """On Oclgrind an invalid access or a race fails the script's wrapper. PoCL is here nearly always."""
    need(name)
    print(run(name, "every_kernel.py"))


def differences(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, float]:
    """max |a − b| / max |a| and RMSE / mean."""
    return float(np.abs(a - b).max() / np.abs(a).max()), float(np.sqrt(((a - b) ** 2).mean()) / a.mean())


def test_the_two_methods_are_two_images(here: dict[str, NDArray[np.float32]]) -> None:
    """One keeps the sun as hard light, the other leaves it in the map: equal images would compare nothing twice."""
    assert differences(here["pixel"].astype(np.float64), here["tree"].astype(np.float64))[0] > 0.01
