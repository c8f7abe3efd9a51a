"""Fitting: a table recovered from five noisy images relights a sixth view under another light.

    python bench/fit.py [--scene report] [-o bench/results/fit.json]

The images are `Scene.render` at its defaults, from the material itself, which knows nothing of the fit's operator;
each value has Gaussian noise of one percent of itself and of its image's mean (root of the squares' sum), seeded. The
sixth view is rendered once with the true material and once with the table, at the same defaults; `error` is their
relative RMSE over covered pixels and channels, and `floor` that of the material's own table, its mean over φ_d on the
fit's nodes: GGX's masking depends on φ_d, Blinn's lobe does not. Measured materials are those of ../shared/data/brdfs
in two angles. The scene `tune` is the one that smoothness, weights and nodes were chosen on; `report` was left alone
until they were.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import networks
import numpy as np
import scenes

import prtcl
from prtcl.compute.device import Device
from prtcl.factors.tabulate import tabulate
from prtcl.scene.camera import Camera
from prtcl.scene.fit import fit
from prtcl.scene.mesh import read_mesh

SCENES = {
    # mesh, light of the images, light of the sixth view, materials
    "tune": ("koala", "kloppenheim_05", "st_fagans_interior",
             ("lambert:albedo=0.7/0.3/0.1", "ggx:alpha=0.25,f0=0.04,kd=0.3/0.2/0.1", "ggx:alpha=0.3,eta=0.2,k=3.0",
              "ggx:alpha=0.2,f0=0.9/0.6/0.3", "merl:nickel", "merl:silver-metallic-paint", "merl:dark-red-paint")),
    "report": ("stanford_bunny", "modern_buildings_2", "st_peters_square_night",
               ("lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.04,kd=0.5", "blinn:exponent=200,ks=0.5,kd=0.1",
                "ggx:alpha=0.3,eta=0.2,k=3.0", "merl:pearl-paint", "merl:gold-metallic-paint")),
}  # fmt: skip
SIZE, NOISE, SEED, VIEWS = (160, 120), 0.01, 7, 5


def material_of(spec: str) -> prtcl.Material:
    """A SPEC, or `merl:NAME` for a fitted measurement in two angles."""
    if spec.startswith("merl:"):
        return networks.measured("merl", spec[5:]).bivariate().material()
    return prtcl.Material.parse(spec)


def cameras(mesh: prtcl.Mesh) -> list[Camera]:
    """Five around the mesh at two heights, and the sixth between them."""
    centre = tuple(mesh.bounds.mean(axis=0))
    framed = Camera.framing(mesh.bounds, fov=35.0, size=SIZE)
    distance = float(np.linalg.norm(np.subtract(framed.eye, framed.target)))
    out = []
    for degrees, height in ((0, 25), (72, 5), (144, 40), (216, 15), (288, 30), (36, 20)):
        a, e = np.radians(degrees), np.radians(height)
        towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        out.append(replace(framed, eye=tuple(centre + distance * towards), target=centre))
    return out


def noisy(image: np.ndarray, seed: int) -> np.ndarray:  # type: ignore[type-arg]
    """With noise of `NOISE` of each value and of the covered pixels' mean."""
    rng, out = np.random.default_rng([SEED, seed]), image.astype(np.float64)
    rgb = out[..., :3]
    mean = rgb[image[..., 3] > 0].mean()
    out[..., :3] = rgb + NOISE * np.hypot(rgb, mean) * rng.normal(size=rgb.shape)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=tuple(SCENES), default="report")
    parser.add_argument("--materials", nargs="+", help="only these")
    parser.add_argument("--cache", type=Path, help="folder where rendered images are kept between runs")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    scenes.require_data()
    device = Device()
    name, light, other, specs = SCENES[options.scene]
    mesh = read_mesh(scenes.mesh_path(name))
    mesh = mesh if mesh.normals is not None else mesh.smooth()
    lights = {key: scenes.environment_path(key) for key in (light, other)}
    own = cameras(mesh)

    def picture(material, key: str, number: int, tag: str = ""):  # type: ignore[no-untyped-def]
        """One image, kept where a cache is named and the material is a true one."""
        kept = options.cache and tag and options.cache / f"{options.scene}_{tag}_{key}_{number}.npy"
        if kept and kept.exists():
            return np.load(kept)
        image = prtcl.Scene(mesh, lights[key], material, own[number], device=device).render().image
        if kept:
            kept.parent.mkdir(exist_ok=True)
            np.save(kept, image)
        return image

    rows = []
    for spec in options.materials or specs:
        true = (
            networks.measured("merl", spec[5:]).bivariate().material()
            if spec.startswith("merl:")
            else prtcl.Material.parse(spec)
        )
        tag = spec.replace("/", "-")
        views = [(own[i], lights[light], noisy(picture(true, light, i, tag), i)) for i in range(VIEWS)]
        start = time.perf_counter()
        found = fit(mesh, views, device=device)
        seconds = time.perf_counter() - start
        own_material = found.table.material()
        true_image = picture(true, other, VIEWS, tag)
        error = scenes.relative_rmse(picture(own_material, other, VIEWS), true_image)
        # What a table can do: the mean over φ_d of the material itself, on the fit's nodes.
        mean = tabulate(true, found.table.theta_h, found.table.theta_d).material()
        floor = scenes.relative_rmse(picture(mean, other, VIEWS), true_image)
        rows.append({"material": spec, "error": error, "floor": floor, "seconds": seconds, **found.report()})
        print(
            f"{spec:40} relit {100 * error:.2f} %, its own table {100 * floor:.2f} %, residual "
            f"{100 * found.residual:.2f} %, noise {100 * found.noise:.2f} %, determined "
            f"{100 * found.determined:.0f} %, {found.outliers} of {found.pixels} out, {seconds:.1f} s",
            flush=True,
        )
    command = " ".join(
        ["python bench/fit.py --scene", options.scene, "--materials", *(options.materials or specs)]
    )
    scenes.save(
        options.output, device=device.name, driver=device.driver,
        command=command, scene=options.scene, mesh=name,
        light_of_images=light, light_of_sixth_view=other, size=SIZE, noise=NOISE, rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
