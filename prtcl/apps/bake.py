"""`prtcl bake`: the visibility of a mesh's vertices, traced once."""

from __future__ import annotations

import argparse
import json
import sys
import time

from prtcl.apps import bake_cluster
from prtcl.apps.cluster import connected
from prtcl.apps.progress import bar
from prtcl.files.array_store import SUMS, import_zarr
from prtcl.files.atomic import check_not_input, check_writable
from prtcl.files.folder import check_folder_writable
from prtcl.scene.bake import Bake
from prtcl.scene.bake_store import is_store
from prtcl.scene.mesh import read_mesh
from prtcl.scene.shaders import Counter


def run(options: argparse.Namespace) -> int:
    """Trace and save."""
    if is_store(options.output):
        import_zarr()
        check_folder_writable(options.output, SUMS)
    else:
        check_writable(options.output)
    check_not_input(options.output, options.mesh)
    start = time.perf_counter()
    mesh = read_mesh(options.mesh)
    mesh = mesh.smooth() if options.smooth else mesh
    for note in mesh.notes:
        print(f"prtcl bake: {note}", file=sys.stderr)
    with connected(options.scheduler) as workers, bar("bake", options.quiet) as notify:
        count = Counter(notify)
        count.expect("vertex", len(mesh.vertices))
        if workers is None:
            bake = Bake.trace(mesh, options.rays, progress=count)
        else:
            bake = bake_cluster.trace(workers, mesh, options.rays, options.chunk, count)
    bake.save(options.output)
    seconds = time.perf_counter() - start
    report = {
        "vertices": len(mesh.vertices),
        "rays": len(mesh.vertices) * 4**options.rays,
        "bytes_per_point": {"visibility_bits": bake.bits.shape[1] * 4},
        "seconds": {"total": seconds},
        "points_per_second": {"visibility_rays": round(len(mesh.vertices) / seconds)},
    }
    if options.json:
        print(json.dumps(report, indent=2))
    elif not options.quiet:
        print(f"{options.output}: {len(mesh.vertices)} vertices, {report['rays']} rays, {seconds:.1f} s")
    return 0
