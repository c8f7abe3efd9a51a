"""Scanned meshes under photographed skies: they run, are finite, and the sun shines from where it is."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import read_mesh
from prtcl.scene.points import pixel_points, shoot
from prtcl.scene.scene import Scene, read_environment

SIZE = (48, 40)


@lru_cache(maxsize=1)
def outdoors(path: Path) -> tuple[Environment, NDArray[np.float64]]:
    """A lawn under a sun 10 degrees high that holds two thirds of the light, and the direction to it."""
    environment, notes = read_environment(path)
    assert notes == [] and environment.image.shape == (512, 1024, 3)
    row, column = np.unravel_index(np.argmax(environment.image.mean(axis=2)), (512, 1024))
    theta, phi = np.pi * (row + 0.5) / 512, 2 * np.pi * (column + 0.5) / 1024
    sun = np.array([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)])
    assert np.degrees(np.arcsin(sun[1])) == pytest.approx(10, abs=1.0)
    return environment, sun


@pytest.mark.parametrize("name", ["spot", "koala", "stanford_bunny"])
def test_a_mesh_in_the_evening_sun(device: Device, shared_data: Path, name: str) -> None:
    environment, sun = outdoors(shared_data / "environments" / "rooitou_park.exr")
    mesh = read_mesh(shared_data / "meshes" / f"{name}.ply")
    # From the side, so that both the sunlit and the dark half are seen.
    side = np.cross(sun, [0.0, 1.0, 0.0])
    centre = mesh.bounds.mean(axis=0)
    camera = Camera(tuple(centre + 1.6 * mesh.scale * side), tuple(centre), size=SIZE)
    scene = Scene(mesh, environment, "lambert:albedo=0.5", camera, device=device)
    made = scene.render(samples=1)
    assert np.isfinite(made.image).all() and made.image.min() >= 0
    assert 0.4 < made.report["light"]["hard_share"] < 1
    pixels = np.arange(SIZE[0] * SIZE[1])
    hits = shoot(scene.tracer, camera, pixels, np.zeros_like(pixels))
    assert len(hits.ray) > 200
    facing = pixel_points(mesh, scene.tracer, hits, np.zeros_like(hits.ray)).frames[:, 2] @ sun
    radiance = made.image.reshape(-1, 4)[hits.ray, :3].mean(axis=1)
    lit, away = radiance[facing > 0.5], radiance[facing < -0.1]
    assert len(lit) > 20 and len(away) > 20
    print(f"{name}: facing the sun {np.median(lit):.2f}, turned away {np.median(away):.2f}")
    assert np.median(lit) > 3 * np.median(away) > 0
    # The sun is to the right or the left in the image as it is in the world.
    columns = hits.ray % SIZE[0]
    right = np.cross(np.subtract(camera.target, camera.eye), camera.up)
    brighter = columns[radiance > np.quantile(radiance, 0.8)].mean() - columns.mean()
    assert brighter * (right @ sun) > 0


def test_an_apartment_from_inside(device: Device, shared_data: Path) -> None:
    """150,000 vertices, unreliable winding; open above. In a room is fine, within a wall's two sides is not."""
    mesh = read_mesh(shared_data / "meshes" / "dream_apartment.ply")
    assert any("degenerate" in note for note in mesh.notes)
    camera = Camera((8.7, 1.43, -4.25), (9.7, 1.03, -4.65), fov=80.0, size=SIZE)
    environment, _ = read_environment(shared_data / "environments" / "lebombo.exr")
    scene = Scene(mesh, environment, "lambert:albedo=0.5", camera, device=device, levels=4)
    made = scene.render(samples=1)
    image = made.image
    print(f"coverage {image[..., 3].mean():.2f}, mean {image[..., :3].mean():.4f}, {made.report['seconds']}")
    assert np.isfinite(image).all() and image.min() >= 0
    assert image[..., 3].mean() > 0.9
    seen = image[image[..., 3] == 1][:, :3].mean(axis=1)
    assert 0 < seen.mean() < environment.image.max()
    assert (seen > 0).mean() > 0.2 and seen.std() > 0
    scene.camera = Camera((6.62, 1.29, -5.78), (9.7, 1.03, -4.65), size=SIZE)
    with pytest.raises(InputError, match="inside the mesh"):
        scene.render()
