"""What leaving out φ_d costs: how far a bivariate table is from the three-angle measurement it was made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from prtcl.factors import three_angles
from prtcl.factors.bivariate import Bivariate, directions
from prtcl.factors.measured import Measured, turns

Array = npt.NDArray[np.float64]
Brdf = Callable[[Array, Array], Array]
"""f of incident and outgoing directions (n, 3): (n, 3)."""


def in_two_angles(table: Bivariate) -> Brdf:
    """A bivariate table as a function of directions; 0 below the horizon."""

    def f(incident: Array, outgoing: Array) -> Array:
        theta_h, theta_d, _ = three_angles.angles(incident, outgoing)
        above = (incident[..., 2] > 0) & (outgoing[..., 2] > 0)
        return np.where(above[..., None], table.evaluate(theta_h, theta_d), 0.0)

    return f


def cosine_weights(measured: Measured) -> Array:
    """(nh, nd, np): share of each valid sample in ∫∫ · cos θ_i cos θ_o dω_i dω_o; 0 below the horizon.

    In the three angles dω_i dω_o = 4 cos θ_d sin θ_d sin θ_h dθ_h dθ_d dφ_d dφ_h, integrated exactly over a node's
    bin but for the two cosines, which are taken in its middle. Bins meet halfway in √θ_h and in θ_d.
    """
    edges_h = _edges(np.sqrt(measured.theta_h), np.sqrt(np.pi / 2)) ** 2
    edges_d = _edges(measured.theta_d, np.pi / 2)
    h, d = measured.theta_h[:, None, None], measured.theta_d[:, None]
    # The two directions are the half vector's part, cos θ_d cos θ_h, and ∓ what lies across it.
    along, across = np.cos(h) * np.cos(d), np.sin(h) * np.sin(d) * np.cos(turns(measured.valid.shape[2]))
    cosines = (along - across) * (along + across)
    weight = -np.diff(np.cos(edges_h))[:, None, None] * np.diff(np.sin(edges_d) ** 2)[:, None] * cosines
    weight = np.where(measured.valid & measured.above, weight, 0.0)
    return np.asarray(weight / weight.sum())


def reduction_error(measured: Measured, reduced: Bivariate | None = None) -> tuple[float, float]:
    """How much a table in two angles (its own by default) differs, over all pairs of directions.

    Returns
    -------
    share : ‖f̃ − f‖ / ‖f‖ in the cosine-weighted norm, √∫∫ f² cos θ_i cos θ_o dω_i dω_o, all channels together. 0
        where f does not depend on φ_d; bounded by 1 for a table of means
    rmse : √⟨(f̃ − f)²⟩ / ⟨f⟩, the same weights: relative RMSE as it is reported of images. A mirror's peak has
        nearly all of f² in nearly none of the directions, so this one may be far above 1
    """
    table = measured.bivariate() if reduced is None else reduced
    weight = cosine_weights(measured)[..., None] / 3
    f = np.where(weight > 0, measured.values, 0.0)
    change = table.evaluate(measured.theta_h[:, None], measured.theta_d)[:, :, None] - f
    square, own = float((weight * change**2).sum()), float((weight * f**2).sum())
    mean = float((weight * f).sum())
    if own == 0.0:
        return 0.0, 0.0
    return (square / own) ** 0.5, square**0.5 / mean


def reciprocity_error(f: Brdf, count: int = 20000, least: float = 0.0) -> float:
    """‖f(i, o) − f(o, i)‖ / ‖f‖ in the cosine-weighted norm, from `count` pairs of directions, the same every time.

    Half vectors are even in √θ_h, which finds lobes; pairs with a cosine that is not above `least` are left out.
    """
    rng = np.random.default_rng(0)
    x, d, phi, turn = rng.random((4, count)) * np.array([1.0, np.pi / 2, 2 * np.pi, 2 * np.pi])[:, None]
    theta = x**2 * (np.pi / 2)
    i, o = directions(theta, d, phi)
    # Turned about the normal as well: f may not be isotropic in every detail.
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    i, o = (np.concatenate([np.einsum("nk,kjn->nj", a[:, :2], axes), a[:, 2:]], axis=1) for a in (i, o))
    kept = (i[:, 2] > least) & (o[:, 2] > least)
    i, o = i[kept], o[kept]
    # dω_i dω_o over the density of the samples, up to a constant.
    weight = (np.sin(theta) * np.sqrt(theta) * np.sin(d) * np.cos(d))[kept] * i[:, 2] * o[:, 2]
    one, other = f(i, o), f(o, i)
    own = float((weight[:, None] * ((one + other) / 2) ** 2).sum())
    return float(np.sqrt((weight[:, None] * (one - other) ** 2).sum() / own)) if own > 0 else 0.0


def sphere_radiance(
    brdfs: Sequence[Brdf],
    image: npt.ArrayLike,
    *,
    points: int = 48,
    samples: int = 64,
    view: tuple[float, float, float] = (0.0, 0.2, 1.0),
    seed: int = 0,
) -> Array:
    """Radiance of points of an unshadowed sphere under an environment, for several BRDFs at once: (brdfs, points, 3).

    Points are even over the sphere's picture. The integral takes samples² directions in proportion to the map's
    radiance and as many half vectors, even in √θ_h and φ_h, weighed by the balance heuristic (Veach 1997): suns and
    lobes are both met. All BRDFs see the same directions, so their difference has far less noise than either.

    Parameters
    ----------
    image : (h, 2 h, 3) radiance, row 0 at the zenith; constant over a texel here
    """
    texels = np.asarray(image, np.float64)
    height, width = texels.shape[:2]
    edges = np.cos(np.linspace(0.0, np.pi, height + 1))
    solid = (edges[:-1] - edges[1:]) * (2 * np.pi / width)
    share = texels.mean(axis=2) * solid[:, None]
    density = share / share.sum() / solid[:, None]
    cumulative = np.cumsum(share.ravel()) / share.sum()
    axis = np.asarray(view, np.float64) / np.linalg.norm(view)
    out, rng = np.zeros((len(brdfs), points, 3)), np.random.default_rng(seed)
    n = samples * samples
    for p in range(points):
        radius, turn = np.sqrt((p + 0.5) / points), p * np.pi * (3 - np.sqrt(5.0))
        disc = np.array([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)])
        frame = _frame(disc @ _frame(axis))
        outgoing = frame @ axis
        # Directions in proportion to the light.
        even = (np.arange(n) + rng.random(n)) / n
        at = np.minimum(np.searchsorted(cumulative, even, side="right"), height * width - 1)
        row, column = np.divmod(at, width)
        y = edges[row] + (edges[row + 1] - edges[row]) * rng.random(n)
        phi = (column + rng.random(n)) * (2 * np.pi / width)
        ring = np.sqrt(1 - y**2)
        lit = np.stack([ring * np.sin(phi), y, -ring * np.cos(phi)], axis=1) @ frame.T
        # Directions reflected by half vectors even in √θ_h.
        a, b = np.divmod(np.arange(n), samples)
        x, phi = (a + rng.random(n)) / samples, (b + rng.random(n)) * (2 * np.pi / samples)
        theta = x**2 * (np.pi / 2)
        half = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
        reflected = 2 * (half @ outgoing)[:, None] * half - outgoing
        incident = np.concatenate([lit, reflected[half @ outgoing > 0]])
        incident = incident[incident[:, 2] > 0]
        half = incident + outgoing
        length = np.linalg.norm(half, axis=1)
        theta = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
        # With √(2θ/π) even, p(ω_h) = 1 / (2π sin θ · π √(2θ/π)).
        steep = np.maximum(2 * np.pi**2 * np.sin(theta) * np.sqrt(theta * (2 / np.pi)), 1e-300)
        world = incident @ frame
        row = np.minimum(
            (np.arccos(np.clip(world[:, 1], -1, 1)) * (height / np.pi)).astype(np.int64), height - 1
        )
        column = (np.arctan2(world[:, 0], -world[:, 2]) % (2 * np.pi) * (width / (2 * np.pi))).astype(
            np.int64
        ) % width
        # |s| is 2 cos θ_d, and dω_i = 4 cos θ_d dω_h.
        total = n * (density[row, column] + 1 / (steep * 2 * length))
        light = texels[row, column] * (incident[:, 2] / total)[:, None]
        for index, f in enumerate(brdfs):
            out[index, p] = (f(incident, np.broadcast_to(outgoing, incident.shape)) * light).sum(axis=0)
    return out


def relative_rmse(values: npt.ArrayLike, expected: npt.ArrayLike) -> float:
    """√mean((I − I_ref)²) / mean(I_ref), over points and channels."""
    own, wanted = np.asarray(values, np.float64), np.asarray(expected, np.float64)
    mean = float(wanted.mean())
    return float(np.sqrt(((own - wanted) ** 2).mean())) / mean if mean > 0 else 0.0


def radiance_change(
    measured: Measured,
    image: npt.ArrayLike,
    reduced: Bivariate | None = None,
    *,
    points: int = 48,
    samples: int = 64,
    seed: int = 0,
) -> float:
    """Relative RMSE of a sphere's picture under an environment when a BRDF goes from three angles to two."""
    table = measured.bivariate() if reduced is None else reduced
    both = (measured.evaluate, in_two_angles(table))
    three, two = sphere_radiance(both, image, points=points, samples=samples, seed=seed)
    return relative_rmse(two, three)


def _edges(nodes: Array, last: float) -> Array:
    return np.concatenate([[0.0], (nodes[1:] + nodes[:-1]) / 2, [max(last, float(nodes[-1]))]])


def _frame(normal: Array) -> Array:
    """Rows tangent, bitangent, normal."""
    side = np.array([1.0, 0, 0]) if abs(normal[0]) < 0.7 else np.array([0.0, 1, 0])
    tangent = np.cross(side, normal)
    tangent /= np.linalg.norm(tangent)
    return np.stack([tangent, np.cross(normal, tangent), normal])
