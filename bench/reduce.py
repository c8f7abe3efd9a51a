"""The two ways to L (+) V, and the inner product: device time on dense light and real visibility statistics.

    python bench/reduce.py [-o bench/results/reduce.json] [--points 4096]

Each row is the median of seven runs after a warm-up, by OpenCL events. The answer of each is checked against the
float64 reference in the run; a wrong one exits non-zero. GB/s counts the bytes that must move (light read, result
written), against what a device-to-device copy of the same light reaches in this run.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from statistics import median

import numpy as np
import pyopencl as cl
import scenes

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.transport import shade
from prtcl.transport.collapse import product_of, visibility_coefficients
from prtcl.wavelet import haar, triple

RUNS = 7


def timed(device: Device, call) -> tuple[float, object]:  # type: ignore[no-untyped-def]
    """Median device seconds of `call` after one warm-up, and its result."""
    seconds = []
    for _ in range(RUNS + 1):
        device.profile.reset()
        result = call()
        device.queue.finish()
        seconds.append(sum(device.profile.device_seconds().values()))
    return median(seconds[1:]), result


def caps(rng: np.random.Generator, points: int, levels: int) -> np.ndarray:
    """Visibility as near geometry makes it: everything but two random caps of the hemisphere. Bits, (n, words)."""
    directions = reference.directions(levels)
    axes = reference.square_to_hemisphere(*rng.uniform(size=(2, 2, points)))
    seen = np.all(np.einsum("knc,sc->kns", axes, directions) < rng.uniform(0.5, 0.95, (2, points, 1)), axis=0)
    return np.packbits(seen, axis=1, bitorder="little").view(np.uint32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--points", type=int, default=2048)
    options = parser.parse_args()
    device, rng, rows, wrong = Device(), np.random.default_rng(1), [], False
    for levels in (5, 6):
        count = options.points
        samples = np.exp(rng.normal(size=(count, 3, 4**levels))).astype(np.float32)
        bits = caps(rng, count, levels)
        light = device.array(samples)
        target = device.empty(light.shape)
        copies = []
        for _ in range(RUNS + 1):
            event = cl.enqueue_copy(device.queue, target.data, light.data)
            event.wait()
            copies.append((event.profile.end - event.profile.start) * 1e-9)
        copy = 2 * light.nbytes / median(copies[1:]) / 1e9
        seen = np.unpackbits(bits[:8].view(np.uint8), axis=1, bitorder="little")[:, None]
        exact = reference.haar(samples[:8] * seen)

        def tree(light=light, bits=bits, levels=levels):  # type: ignore[no-untyped-def]
            return triple.reduce(
                device, haar.forward(device, light), visibility_coefficients(device, bits, levels)
            )

        def pixel(light=light, bits=bits, levels=levels):  # type: ignore[no-untyped-def]
            return product_of(device, light, bits, levels, levels)

        for name, call in (("tree", tree), ("pixel", pixel)):
            seconds, result = timed(device, call)
            error = np.linalg.norm(result[:8].get() - exact, axis=-1) / np.linalg.norm(exact, axis=-1)  # type: ignore[index]
            moved = 2 * light.nbytes / seconds / 1e9
            wrong |= bool(error.max() > 2e-5)
            rows.append(
                {"case": f"reduce {name}", "levels": levels, "points": count, "seconds": seconds,
                 "points_per_second": round(count / seconds), "gb_per_second": moved, "share_of_copy": moved / copy,
                 "worst_relative_error": float(error.max())}
            )  # fmt: skip
        slices = device.array(rng.normal(size=(256, 3, 4**levels)))
        index = np.stack([np.arange(count) % 255, np.arange(count) % 255 + 1], axis=1)
        weight = np.full((count, 2), 0.5)
        for lanes in (shade.LANES_CPU, shade.LANES_GPU):

            def product(light=light, slices=slices, index=index, weight=weight, levels=levels, lanes=lanes):  # type: ignore[no-untyped-def]
                return shade.soft_radiance(device, light, slices, index, weight, levels, lanes=lanes)

            seconds, _ = timed(device, product)
            moved = light.nbytes / seconds / 1e9
            rows.append(
                {"case": f"inner product, 2 slices, {lanes} lanes", "levels": levels, "points": count,
                 "seconds": seconds, "points_per_second": round(count / seconds), "gb_per_second": moved,
                 "share_of_copy": moved / copy}
            )  # fmt: skip
        rows.append({"case": "copy", "levels": levels, "points": count, "gb_per_second": copy})
    for row in rows:
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()))
    scenes.save(options.output, device=device.name, driver=device.handle.driver_version, rows=rows)
    if wrong:
        sys.exit("a result was wrong")


if __name__ == "__main__":
    main()
