"""`prtcl render`: an image of a mesh under an environment."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from prtcl.apps.progress import bar
from prtcl.apps.scene_options import scene_of
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.files.atomic import check_not_input, check_writable
from prtcl.scene.bake import is_bake
from prtcl.scene.plan import Plan
from prtcl.scene.scene import Render


def run(options: argparse.Namespace) -> int:
    """Render, save, report. Outputs are checked before the work."""
    preview = None
    if options.png is not None:
        preview = Path(options.png) if options.png else Path(options.output).with_suffix(".png")
        if preview.suffix.lower() != ".png":
            raise InputError(f"--png {preview}: expected a name that ends in .png")
    if not abs(options.exposure) <= 1000:
        raise InputError(f"--exposure {options.exposure}: expected stops between -1000 and 1000")
    if options.plan is not None and options.error is not None:
        raise InputError("--plan and --error: a plan has its error; give one of them")
    if options.save_plan is not None and options.error is None and options.plan is None:
        raise InputError("--save-plan: there is a plan only where an --error is asked for")
    for path in filter(None, (options.output, preview, options.save_plan)):
        check_writable(path)
        check_not_input(path, options.mesh, options.env)
    if is_bake(options.mesh) and options.points == "pixel":
        raise InputError(
            f"--points pixel: {options.mesh} holds the rays of vertices, not of pixels; render the mesh it was made of"
        )
    devices = [Device(spec, precision=options.precision) for spec in options.device or [None]]
    plan = None if options.plan is None else Plan.load(options.plan)
    scene = scene_of(options, devices, options.brdf)
    with bar("render", options.quiet) as notify:
        render = scene.render(
            points=options.points or (plan.points if plan is not None else "pixel"), samples=options.samples,
            error=options.error, plan=plan, progress=notify,
        )  # fmt: skip
    render.save(options.output, png=preview, exposure=options.exposure, error=options.error_channel)
    if options.save_plan is not None and render.plan is not None:
        render.plan.save(options.save_plan)
    doubt = render.report.get("plan", {}).get("doubt")
    if doubt is not None:
        print(f"prtcl render: what this picture errs is not known: {doubt}", file=sys.stderr)
    elif render.plan is not None and render.plan.predicted > render.plan.asked:
        print(
            f"prtcl render: the error asked for was not reached: {render.plan.asked:g} asked, about "
            f"{render.plan.predicted:.2g} found",
            file=sys.stderr,
        )
    if options.json:
        print(json.dumps(render.report, indent=2))
    elif not options.quiet:
        print(summary(render, options.output))
    if options.explain:
        print(explain(render), file=sys.stderr if options.json else sys.stdout)
    return 0


def summary(render: Render, output: str) -> str:
    """One line on what was made."""
    report = render.report
    height, width = render.image.shape[:2]
    points = sum(report["points_shaded"].values())
    error = ""
    if render.plan is not None and report["plan"]["doubt"] is None:
        plan = render.plan
        error = f"expected error {100 * plan.predicted:.2g} % ({100 * plan.confidence:.0f} % confidence), "
    return (
        f"{output}: {width}x{height}, {points} points, {report['rays'] / 1e6:.1f} M rays, {error}"
        f"{report['seconds']['total']:.1f} s on {report['device']}"
    )


def explain(render: Render) -> str:
    """What was chosen and why, a line each."""
    report = render.report
    light = report["light"]
    layers = ", ".join(f"{n:.1f}" for n in report["points_per_pixel"])
    return "\n".join(
        [
            f"device      {report['device']} ({report['device_reason']}), {report['precision']}",
            *(
                f"resolution  light 4^{own['levels']}, visibility 4^{own['rays']}, kept 4^{own['keep']} directions, "
                f"{own['views']} view angles, product in the "
                f"{'quadtree' if own['method'] == 'tree' else 'pixel domain'}\n            {own['why']}"
                for own in report["settings"]
            ),
            f"hard light  {light['hard_samples']} samples hold {100 * light['hard_share']:.1f} % of the energy"
            if light["hard_samples"]
            else "hard light  none needed: no direction holds enough energy",
            *(f"left out    {_item(item)}" for item in report["left_out"]),
            f"points      {layers} a covered pixel (soft light, hard light); estimated pixel error "
            f"{100 * report['pixel_error_estimate']:.2f} %",
            *(f"plan        {line}" for line in (render.plan.explain() if render.plan is not None else ())),
        ]
    )


def _item(item: dict[str, Any]) -> str:
    """One thing that was left out, what it saved and cost; savings are estimates from this run."""
    saved = [f"{item['seconds']:.2g} s"] if item["seconds"] > 0.0 else []
    saved += [f"{item['bytes'] / 2**20:.3g} MiB"] if item["bytes"] > 0 else []
    cost = f"; at most {100 * item['error']:.1g} % of error" if item["error"] > 0.0 else ""
    return (
        f"{item['name']}: {item['count']} of {item['of']} {item['unit']}"
        f"{', saving about ' + ' and '.join(saved) if saved else ''}{cost}"
    )
