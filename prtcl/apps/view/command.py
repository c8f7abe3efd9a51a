"""`prtcl view`: materials and light edited in the browser, pictures from this machine's device."""

from __future__ import annotations

import argparse
import math
import os
import sys
import threading
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from prtcl import quadtree
from prtcl.apps.bake_options import read_bake
from prtcl.apps.progress import bar
from prtcl.apps.view import web
from prtcl.apps.view.look import Look
from prtcl.apps.view.loop import Loop
from prtcl.apps.view.page import Page
from prtcl.apps.view.state import Eye
from prtcl.apps.view.studio import Studio
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.material import Material
from prtcl.factors.visibility import Progress
from prtcl.scene.bake import Bake, is_bake
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.plan_session import plan_session
from prtcl.scene.scene import own_materials
from prtcl.scene.session import ERROR
from prtcl.scene.shaders import Counter

ENDINGS = (".exr", ".hdr")
FOV = 30.0
"""Vertical, degrees."""
RAYS = 5


def run(options: argparse.Namespace) -> int:
    """Serve until interrupted."""
    check(options)
    environments = listed(options.env)
    folder = writable_folder(options.output)
    mesh, bake = read(options)
    looks = starting_looks(mesh, options.brdf)
    studio = Studio(
        mesh, environments, Device(options.device), bake=bake, levels=options.levels,
        rays=RAYS if options.rays is None else options.rays,
        error=ERROR if options.error is None else options.error, size=options.size, up=options.env_up,
        repair=options.repair,
    )  # fmt: skip
    first = next(iter(environments))
    notes = studio.environment(first)[2]  # read now, so that a bad one is told here
    for note in (*mesh.notes, *notes):
        print(f"prtcl view: {note}", file=sys.stderr)
    up = (0.0, 0.0, 1.0) if options.env_up == "z" else (0.0, 1.0, 0.0)
    camera = Camera.framing(mesh.bounds, up=up, fov=FOV, size=(1, 1))
    if options.error:
        light = replace(studio.environment(first)[0], rotate=options.env_rotate)
        plan = plan_session(
            mesh, light, [look.material for look in looks], camera.eye, options.error, device=studio.device,
            levels=options.levels, rays=options.rays if bake is None else bake.rays,
        )  # fmt: skip
        studio.levels, studio.rays, studio.error = plan.levels, plan.rays, plan.error
        if not options.quiet:
            print(
                f"prtcl view: 4^{plan.levels} directions, 4^{plan.rays} rays, cuts of {100 * plan.error:.2g} %: "
                f"vertices are expected to err by {100 * plan.predicted:.2g} % "
                f"({100 * plan.confidence:.0f} % confidence)",
                file=sys.stderr,
            )
    server = web.start(options.host, options.port, camera, Eye.of(camera).fov)
    loop = Loop(studio)
    try:
        web.check_viser(server)
        names, coloured = tuple(environments), bool(mesh.coloured.any())
        seat_pages(
            server, options.host, loop,
            lambda client: Page(client, loop, looks, part_names(mesh), names, options.env_rotate, folder, coloured),
        )  # fmt: skip
        at = web.url(options.host, server.get_port())
        if not options.quiet:
            print(f"{at}  ({studio.device.name}, {len(mesh.vertices)} vertices; Ctrl-C ends)", flush=True)
        if options.open:
            webbrowser.open(at)
        serve(loop, options.quiet)
    except KeyboardInterrupt:
        if not options.quiet:
            print("prtcl view: ended", file=sys.stderr)
    finally:
        loop.stop()
        web.stop(server)
    return 0


def check(options: argparse.Namespace) -> None:
    """Refuse numbers out of range before anything starts.

    Raises
    ------
    InputError
        Naming the option.
    """
    levels = options.levels
    if levels is not None and not 1 <= levels <= quadtree.MAX_LEVELS:
        raise InputError(f"--levels: expected 1 to {quadtree.MAX_LEVELS}, got {levels}")
    most = quadtree.MAX_LEVELS if levels is None else levels
    if options.rays is not None and not 1 <= options.rays <= most:
        raise InputError(f"--rays: expected 1 to {most}, at most --levels, got {options.rays}")
    if options.error is not None and not 0.0 <= options.error < 1.0:
        raise InputError(f"--error: expected 0 or more and below 1, got {options.error}")
    if not math.isfinite(options.env_rotate):
        raise InputError(f"--env-rotate: expected degrees, got {options.env_rotate}")


def seat_pages(server: Any, host: str, loop: Loop, make: Callable[[Any], Page]) -> None:
    """Give every browser that connects a page of its own."""
    pages: dict[int, Page] = {}
    lock = threading.Lock()

    @server.on_client_connect  # type: ignore[untyped-decorator, unused-ignore]
    async def come(client: Any) -> None:
        if web.is_own_page(server, client.client_id, host):
            page = make(client)
            with lock:
                pages[client.client_id] = page

    @server.on_client_disconnect  # type: ignore[untyped-decorator, unused-ignore]
    async def go(client: Any) -> None:
        with lock:
            page = pages.pop(client.client_id, None)
        if page is not None:
            loop.leave(page.seat)


def serve(loop: Loop, quiet: bool) -> None:
    """Trace on one thread and render on another, until one of them fails or Ctrl-C is pressed."""
    failures: list[BaseException] = []
    ended = threading.Event()

    def kept(job: Callable[[], None], forever: bool) -> Callable[[], None]:
        def work() -> None:
            try:
                job()
            except BaseException as error:
                failures.append(error)
                ended.set()
            if forever:
                ended.set()

        return work

    def trace() -> None:
        loop.announce("Tracing visibility …")
        # A bar that is interrupted must still close.
        with ExitStack() as bars:
            loop.studio.trace(lambda what: _progress(what, loop, quiet, bars), loop.wake)

    # Daemons: Ctrl-C does not wait for rays.
    threads = [
        threading.Thread(target=kept(trace, False), daemon=True),
        threading.Thread(target=kept(loop.run, True), daemon=True),
    ]
    for thread in threads:
        thread.start()
    ended.wait()
    if failures:
        raise failures[0]


def _progress(what: str, loop: Loop, quiet: bool, bars: ExitStack) -> Progress:
    """Counts traced vertices on the terminal's bar and in the pages."""
    notify = bars.enter_context(bar(what, quiet))
    shown = -1

    def both(done: int, known: int) -> None:
        nonlocal shown
        if notify is not None:
            notify(done, known)
        percent = 100 * done // max(1, known)
        if percent >= shown + 2 and what == "trace":
            shown = percent
            loop.announce(f"Tracing visibility: {percent} %. Pictures are previews.")

    count = Counter(both)
    count.expect("vertex", len(loop.studio.mesh.vertices))
    return count


def read(options: argparse.Namespace) -> tuple[Mesh, Bake | None]:
    """The mesh, with normals, and its bake where the command line names one.

    Raises
    ------
    InputError
        If it cannot be read, or --rays or --smooth ask for what a bake has decided.
    """
    if is_bake(options.mesh):
        bake = read_bake(options.mesh, options.rays, options.smooth)
        return bake.mesh, bake
    mesh = read_mesh(options.mesh)
    return (mesh.smooth() if options.smooth or mesh.normals is None else mesh), None


def starting_looks(mesh: Mesh, brdf: str | None) -> tuple[Look, ...]:
    """What the parts wear at first."""
    if brdf is not None:
        return (Look.of(Material.parse(brdf)),) * len(mesh.materials)
    return tuple(Look.of(material) for material in own_materials(mesh))


def part_names(mesh: Mesh) -> tuple[str, ...]:
    """A name for each part, no two alike."""
    return tuple(
        f"{number} {part.name}".rstrip() if part is not None else f"{number}"
        for number, part in enumerate(mesh.materials, 1)
    )


def listed(given: list[str]) -> dict[str, Path]:
    """The environments that pages may choose from: files, and what is in folders now, under names no two alike.

    Raises
    ------
    InputError
        If a file is not there, or a folder holds none.
    """
    paths: list[Path] = []
    for text in given:
        path = Path(text)
        if path.is_dir():
            found = sorted(p for p in path.iterdir() if p.suffix.lower() in ENDINGS and p.is_file())
            if not found:
                raise InputError(f"--env {text}: there is no {' or '.join(ENDINGS)} in this folder")
            paths += found
        elif not path.is_file():
            raise InputError(f"--env {text}: no such file or folder")
        else:
            paths.append(path)
    names: dict[str, Path] = {}
    for path in paths:
        name, number = path.stem, 2
        while name in names and names[name] != path:
            name, number = f"{path.stem} ({number})", number + 1
        names[name] = path
    return names


def writable_folder(text: str) -> Path:
    """The folder that pages save into; made where it is not there.

    Raises
    ------
    InputError
        If it cannot be made or written.
    """
    folder = Path(text)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--output {text}: expected a folder to save into: {error}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"--output {text}: the folder cannot be written; name another")
    return folder.resolve()
