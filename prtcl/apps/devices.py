"""`prtcl devices`: what OpenCL sees, which is used, why."""

from __future__ import annotations

import argparse
import json

from prtcl.compute.choice import choose, devices


def run(options: argparse.Namespace) -> int:
    """Print every device and the one that would be used."""
    seen = devices()
    chosen, reason = choose(options.device, seen)
    if options.json:
        rows = [{k: v for k, v in vars(device).items() if k != "handle"} for device in seen]
        print(json.dumps({"devices": rows, "used": chosen.spec, "why": reason}, indent=2))
        return 0
    for device in seen:
        mark = "*" if device is chosen else " "
        print(
            f"{mark} {device.spec:5} {device.kind:4} {device.platform} / {device.name}\n"
            f"        {device.compute_units} compute units, {device.memory / 2**30:.1f} GiB, largest buffer "
            f"{device.max_allocation / 2**30:.1f} GiB, float64 {'yes' if device.float64 else 'no'}, "
            f"driver {device.driver}" + (f"\n        unusable: {device.flaw}" if device.flaw else "")
        )
    print(f"used: {chosen.spec} {chosen.name}: {reason}")
    return 0
