"""Which OpenCL device is used, and why.

An explicit argument wins over the environment variable ``PRTCL_DEVICE``, which wins over the first GPU, then
any accelerator, then the first CPU. Platforms with no device, and devices that cannot work, are skipped. A SPEC
is ``platform`` or ``platform:device``; each part is an index or a piece of the name, upper or lower case alike.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

from prtcl.compute import vendors
from prtcl.errors import DeviceError, InputError

VARIABLE = "PRTCL_DEVICE"


@dataclass(frozen=True)
class Seen:
    """One OpenCL device of this machine, as `devices` lists it."""

    platform_index: int
    device_index: int
    platform: str
    name: str
    kind: str
    driver: str
    memory: int
    max_allocation: int
    compute_units: int
    float64: bool
    handle: Any
    flaw: str = ""
    """Why it cannot be used; empty where it can."""

    @property
    def spec(self) -> str:
        """The SPEC that names exactly this device."""
        return f"{self.platform_index}:{self.device_index}"


def _kind(device: Any, cl: Any) -> str:
    for kind in ("GPU", "ACCELERATOR", "CPU"):
        if device.type & getattr(cl.device_type, kind):
            return kind
    return "OTHER"


def _flaw(version: str) -> str:
    """Why a device of this version text cannot build kernels, or nothing.

    PoCL names the CPU that it compiles for at the end of its version. Where its LLVM is older than the CPU that is
    "generic", which the same LLVM's clang then refuses for x86: every build fails (pocl issue 1049; the wheel's PoCL
    3.0 on AMD's Zen 5).
    """
    if "PoCL" in version and "x86_64" in version and version.endswith("-generic"):
        return "this PoCL is older than this CPU and cannot compile for it"
    return ""


def devices() -> list[Seen]:
    """Every device of every OpenCL platform, in the platforms' own order.

    Raises
    ------
    DeviceError
        If no OpenCL platform is installed; the message says which command brings PoCL.
    """
    vendors.reveal()
    import pyopencl as cl

    try:
        platforms = cl.get_platforms()
    except cl.LogicError as error:
        raise DeviceError(
            "no OpenCL platform was found on this machine\n"
            "install one that runs on any CPU with: pip install 'prtcl[pocl]'"
        ) from error
    seen = []
    for p, platform in enumerate(platforms):
        try:
            handles = platform.get_devices()
        except cl.RuntimeError:
            continue  # rusticl and Clover answer so when they have no device
        for d, handle in enumerate(handles):
            seen.append(
                Seen(
                    platform_index=p,
                    device_index=d,
                    platform=platform.name.strip(),
                    name=handle.name.strip(),
                    kind=_kind(handle, cl),
                    driver=handle.driver_version.strip(),
                    memory=handle.global_mem_size,
                    max_allocation=handle.max_mem_alloc_size,
                    compute_units=handle.max_compute_units,
                    float64=bool(handle.double_fp_config) if "cl_khr_fp64" in handle.extensions else False,
                    handle=handle,
                    flaw=_flaw(handle.version.strip()),
                )
            )
    if not seen:
        names = ", ".join(platform.name.strip() for platform in platforms)
        raise DeviceError(
            f"the OpenCL platforms of this machine have no device: {names}\n"
            "install one that runs on any CPU with: pip install 'prtcl[pocl]'"
        )
    return seen


def _matches(part: str, index: int, *names: str) -> bool:
    if part.isdigit():
        return index == int(part)
    return any(part.lower() in name.lower() for name in names)


def _unusable(device: Seen) -> DeviceError:
    return DeviceError(
        f"{device.platform} / {device.name} (driver {device.driver}): {device.flaw}\n"
        "install an implementation that knows it, Intel's for any x86 CPU: pip install 'prtcl[intel]'"
    )


def choose(spec: str | None = None, seen: list[Seen] | None = None) -> tuple[Seen, str]:
    """The device to use and the reason in words.

    Parameters
    ----------
    spec : ``platform`` or ``platform:device`` (indices or parts of names); None asks ``PRTCL_DEVICE``, then
        takes the first GPU, accelerator or CPU
    seen : the devices to choose from; None looks

    Raises
    ------
    InputError
        If nothing matches the SPEC: the message lists what there is.
    DeviceError
        If the machine has no OpenCL device, or none that can work.
    """
    seen = devices() if seen is None else seen
    source = "--device"
    if spec is None:
        spec, source = os.environ.get(VARIABLE) or None, VARIABLE
    if spec is None:
        for kind in ("GPU", "ACCELERATOR", "CPU", "OTHER"):
            for device in seen:
                if device.kind == kind and not device.flaw:
                    better = {"GPU": "", "ACCELERATOR": "; no GPU was found"}.get(kind, "; no GPU was found")
                    return device, f"first {kind} found{better}"
        raise _unusable(seen[0])
    platform, _, name = spec.partition(":")
    for device in seen:
        if _matches(platform, device.platform_index, device.platform) and (
            not name or _matches(name, device.device_index, device.name)
        ):
            if device.flaw:
                raise _unusable(device)
            return device, f"asked for by {source} {spec}"
    there = ", ".join(f"{device.spec} {device.platform} / {device.name}" for device in seen)
    raise InputError(f"{source} {spec}: no OpenCL device matches platform:device\nthere are: {there}")
