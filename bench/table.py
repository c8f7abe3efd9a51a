"""The README's tables from bench/results/*.json, as Markdown on standard output: `python bench/table.py`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parent / "results"
Data = dict[str, Any]
"""What a results file of the function's name holds."""


def accuracy(data: Data) -> None:
    """Error against the float64 reference, a line a scene, a column a material."""
    materials = list(dict.fromkeys(row["material"] for row in data["rows"]))
    print("| mesh | environment | " + " | ".join(f"`{m}`" for m in materials) + " |")
    print("|---" * (2 + len(materials)) + "|")
    scenes = list(dict.fromkeys((row["mesh"], row["environment"]) for row in data["rows"]))
    for mesh, environment in scenes:
        cells = [
            f"{100 * row['relative_rmse']:.2f} % (±{100 * row['reference_noise']:.2f}), {row['seconds']:.0f} s"
            for row in data["rows"]
            if (row["mesh"], row["environment"]) == (mesh, environment)
        ]
        print(f"| {mesh} | {environment} | " + " | ".join(cells) + " |")
    print(f"\n{data['size'][0]} × {data['size'][1]} pixels, {data['device']}, `{data['command']}`\n")


def mitsuba(data: Data) -> None:
    """Error against the path tracer: its own noise taken off, the worst of each material."""
    print(
        "| material | scenes | error without Mitsuba's noise, median and worst | that noise | bias, worst |"
    )
    print("|---|---|---|---|---|")
    for material in dict.fromkeys(row["material"] for row in data["rows"]):
        rows = [row for row in data["rows"] if row["material"] == material]
        own = sorted(max(0.0, r["relative_rmse"] ** 2 - r["mitsuba_noise"] ** 2) ** 0.5 for r in rows)
        noise = sorted(row["mitsuba_noise"] for row in rows)
        bias = max((row["bias"] for row in rows), key=abs)
        print(
            f"| `{material}` | {len(rows)} | {100 * own[len(own) // 2]:.2f} %, {100 * own[-1]:.2f} % | "
            f"{100 * noise[0]:.2f} to {100 * noise[-1]:.2f} % | {100 * bias:+.2f} % |"
        )


def editing(data: Data) -> None:
    """Frame time and error of a session's materials."""
    print("\n| material | a frame | frames/s | leaves, nodes | error of the cuts | whole error |")
    print("|---|---|---|---|---|---|")
    for row in data["rows"]:
        stages = " + ".join(f"{ms:.1f}" for ms in row["device_ms"].values())
        print(
            f"| `{row['material']}` | {row['milliseconds']:.0f} ms ({stages}) | {row['frames_per_second']:.0f} | "
            f"{row['leaves']:.0f}, {row['hard_nodes']} | {100 * row['cut_error']:.2f} % | "
            f"{100 * row['error']:.2f} % |"
        )
    print(
        f"\n{data['mesh']}, {data['vertices']} vertices, {data['shaded']} points shaded, {data['environment']}, "
        f"{data['device']}; once: {data['once_seconds']}\n"
    )


def visibility(data: Data) -> None:
    """Rays saved, and what that costs."""
    print(
        "\n| mesh | cells | every ray, of bare embree | rays traced | wrong bits | times as fast | points/s |"
    )
    print("|---|---|---|---|---|---|---|")
    for row in data["rows"]:
        print(
            f"| {row['mesh']} | {row['cells']} | {100 * row['every_of_bare']:.0f} % | 1/{row['rays_saved']:.1f} | "
            f"{100 * row['wrong_bits']:.3f} % | {row['times_faster']:.1f} | {row['points_per_second']:,.0f} |"
        )


def browser(data: Data) -> None:
    """What a browser gets of the viewer."""
    for name, row in data["rows"].items():
        print(f"{name}: " + ", ".join(f"{key} {value:.1f}" for key, value in row.items()))


def bench(data: Data) -> None:
    """`prtcl bench`: rates and shares of the neighbouring copy; rivals of three channels."""
    ours = [row for row in data["rows"] if row["rival"] is None]
    sizes = sorted({row["levels"] for row in ours})
    most = max(row["channels"] for row in ours)
    print("\n| stage | " + " | ".join(f"4^{levels} directions" for levels in sizes) + " |")
    print("|---" * (1 + len(sizes)) + "|")
    for title in dict.fromkeys(row["title"] for row in ours):
        cells = []
        for levels in sizes:
            own = [row for row in ours if (row["title"], row["levels"]) == (title, levels)]
            row = max(own, key=lambda each: each["channels"])
            share = row["share_of_copy"]
            cells.append(f"{row['points_per_second']:,.0f}/s" + (f", {100 * share:.0f} %" if share else ""))
        print(f"| {title} | " + " | ".join(cells) + " |")
    rivals = [row for row in data["rows"] if row["rival"] is not None and row.get("times_faster")]
    print("\n| stage | rival | times as fast |\n|---|---|---|")
    for title, rival in dict.fromkeys((row["title"], row["rival"]) for row in rivals):
        found = [row for row in rivals if (row["title"], row["rival"]) == (title, rival)]
        times = [row["times_faster"] for row in found if row["channels"] == most or row["channels"] == 1]
        print(f"| {title} | {rival} | {min(times):.1f} to {max(times):.1f} |")
    print(f"\n{data['device']}, {data['platform']}, {data['date']}, `{data['command']}`\n")


def change_light(data: Data) -> None:
    """The same for a change of light."""
    change_view(data)


def change_view(data: Data) -> None:
    """What a change costs here and in Mitsuba at equal error: the session's default setting, by the lower figure."""
    print(
        "\n| change | environment | material | points | ours | error | Mitsuba at that error | times as fast |"
    )
    print("|---" * 8 + "|")
    for row in data["rows"]:
        if row["setting"] == 0.01:
            print(
                f"| {row['change']} | {row['environment']} | `{row['material']}` | {row['points']:,} | "
                f"{1e3 * row['seconds']:,.0f} ms | {100 * max(row['error'], row['check']['rmse']):.2f} % | "
                f"{row['times_faster_by_check'] * row['seconds']:.1f} s | {row['times_faster_by_check']:.0f} |"
            )


def sparse(data: Data) -> None:
    """The reduction in place against the dense one."""
    print(
        "\n| mesh | directions | mixed, hidden squares | dense, points/s | in place | times as fast |\n"
        + "|---" * 6
        + "|"
    )
    for row in data["rows"]:
        print(
            f"| {row['mesh']} | 4^{row['levels']} | {100 * row['mixed']:.0f} %, {100 * row['hidden']:.0f} % | "
            f"{row['dense_points_per_second']:,.0f} | {row['sparse_points_per_second']:,.0f} | "
            f"{row['times_faster']:.1f} |"
        )


def plan(data: Data) -> None:
    """What was asked of `--error`, predicted and found, beside the best fixed setting."""
    print(
        "\n| mesh | environment | material | asked | predicted | found | chosen | time (pilot) | best fixed setting |\n"
        + "|---" * 9 + "|"
    )  # fmt: skip
    for row in data["rows"]:
        where = f"{row['mesh']}{'' if row['unseen'] else ' *'} | {row['environment']} | `{row['material']}`"
        if "refused" in row:
            print(f"| {where} | {100 * row['asked']:.0f} % | refused | | | | |")
            continue
        best, points = row["best_fixed"], " + ".join(f"{n:.0f}" for n in row["points_per_pixel"])
        beside = "none meets it" if any(own["fixed"] for own in data["scenes"]) else "not measured"
        if best is not None:
            how = (
                f"{best['samples']} × {best['samples']} points"
                if "samples" in best
                else f"aim {best['pixel_error']:g}"
            )
            beside = (
                f"4^{best['rays']} rays, {how}: {best['seconds']:.1f} s, {100 * best['error']:.2f} %; "
                f"**{row['seconds'] / best['seconds']:.2f} ×**"
            )
        print(
            f"| {where} | {100 * row['asked']:.0f} % | {100 * row['predicted']:.2f} % | {100 * row['true']:.2f} % | "
            f"4^{row['rays']} rays, {points} points | {row['seconds']:.1f} s ({row['pilot_seconds']:.1f}) | {beside} |"
        )
    print(f"\n{data['size'][0]} × {data['size'][1]} pixels, {data['device']}, `{data['command']}`\n")


def relight(data: Data) -> None:
    """A batch's errors, and what else could make it."""
    rival = {(row["environment"], row["material"]): row for row in data["rival"]["frames"]}
    print("\n| environment | material | error (reference's noise) | Mitsuba, a frame at that error |")
    print("|---" * 4 + "|")
    for row in data["errors"]:
        other = rival[row["environment"], row["material"]]
        print(
            f"| {row['environment']} | `{row['material']}` | {100 * row['relative_rmse']:.2f} % "
            f"(±{100 * row['reference_noise']:.2f}) | {other['seconds']:.0f} s |"
        )
    print(
        f"\n{data['frames']} frames of {data['size'][0]} × {data['size'][1]} in {data['seconds']:.0f} s, "
        f"{data['frames_per_second']:.2f} a second; a loop over renders {data['loop']['speedup']:.0f} times, Mitsuba "
        f"{data['rival']['speedup']:.0f} times as long (both extrapolated); {data['mesh']}, {data['device']}, "
        f"`{data['command']}`\n"
    )


def leave_out(data: Data) -> None:
    """Each name on and off."""
    for case in data["cases"]:
        best = case["rows"][0]
        print(f"\n{case['scene']}, {case['points']} points\n")
        print(
            "| left out | time | device memory | all points' bytes | rays | picture differs by |\n"
            + "|---" * 6
            + "|"
        )
        for row in case["rows"]:
            print(
                f"| {row['leave_out']} | {row['seconds']:.2f} s, {row['seconds'] / best['seconds']:.2f} × | "
                f"{row['device_bytes'] / 2**20:.0f} MiB, {row['device_bytes'] / best['device_bytes']:.2f} × | "
                f"{row['bytes_of_all_points'] / 2**20:.0f} MiB, "
                f"{row['bytes_of_all_points'] / best['bytes_of_all_points']:.2f} × | {row['rays'] / 1e6:.1f} M | "
                f"{100 * row['difference']:.3f} % |"
            )
    print(f"\n{data['device']}, `{data['command']}`\n")


TABLES = (
    accuracy, mitsuba, editing, visibility, browser, bench, change_view, change_light, sparse, plan, relight, leave_out,
)  # fmt: skip

if __name__ == "__main__":
    for table in TABLES:
        path = RESULTS / f"{table.__name__}.json"
        if path.is_file():
            table(json.loads(path.read_text(encoding="utf-8")))
