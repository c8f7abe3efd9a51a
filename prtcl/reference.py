"""The pipeline in float64 NumPy, plain and slow, from the definitions: the tests' oracle, and users' too.

Nothing here is shared with the fast path except the quadtree layout. Directions are unit vectors in a point's
own frame (z is the normal) unless a docstring says world (right-handed, Y up). Radiance is linear RGB.

Equations (1) and (5) are those of Sitthi-Amorn, Romeiro, Zickler, Lawrence, "Factoring Lighting, Visibility,
and Bivariate Reflectance for Interactive Editing" (supplemental).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import numpy.typing as npt

from prtcl import quadtree

Array = npt.NDArray[np.float64]
Occluded = Callable[[npt.NDArray[np.float32], npt.NDArray[np.float32]], npt.NDArray[np.bool_]]

# --- Haar --------------------------------------------------------------------------------------------------


def haar(samples: npt.ArrayLike) -> Array:
    """Nonstandard orthonormal 2D Haar transform of Morton-ordered samples.

    Parameters
    ----------
    samples : (..., 4**levels)

    Returns
    -------
    coefficients : (..., 4**levels) float64, by level (see `prtcl.quadtree`)

    Examples
    --------
    >>> haar([1.0, 2.0, 3.0, 4.0])      # mean * 2, then columns, rows, both
    array([ 5., -1., -2.,  0.])
    """
    means = np.asarray(samples, dtype=np.float64)
    levels = quadtree.levels_of(means.shape[-1])
    coefficients = np.empty_like(means)
    for level in reversed(range(levels)):
        children = means.reshape(*means.shape[:-1], -1, 4)
        details = children @ (quadtree.SIGNS.T / 2.0)
        start, stop = quadtree.n_samples(level), quadtree.n_samples(level + 1)
        coefficients[..., start:stop] = details.reshape(*means.shape[:-1], -1)
        means = children.sum(axis=-1) / 2.0
    coefficients[..., 0] = means[..., 0]
    return coefficients


def ihaar(coefficients: npt.ArrayLike) -> Array:
    """Inverse of `haar`: (..., 4**levels) coefficients to Morton-ordered samples, float64."""
    values = np.asarray(coefficients, dtype=np.float64)
    levels = quadtree.levels_of(values.shape[-1])
    means = values[..., :1]
    for level in range(levels):
        start, stop = quadtree.n_samples(level), quadtree.n_samples(level + 1)
        details = values[..., start:stop].reshape(*values.shape[:-1], -1, 3)
        children = (means[..., None] + details @ quadtree.SIGNS.astype(np.float64)) / 2.0
        means = children.reshape(*values.shape[:-1], -1)
    return means.copy()


def basis(levels: int) -> Array:
    """Every basis function on the grid: (4**levels functions, 4**levels samples)."""
    return ihaar(np.eye(quadtree.n_samples(levels)))


# --- triple products -----------------------------------------------------------------------------------------


def tripling_coefficients(levels: int) -> Array:
    """C_ijk = Σ_s ρ_i(s) ρ_j(s) ρ_k(s) by brute force: (n, n, n) with n = 4**levels. For levels ≤ 3."""
    functions = basis(levels)
    return np.einsum("is,js,ks->ijk", functions, functions, functions, optimize=True)


def triple(a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
    """The oracle: a ⊕ b is the Haar transform of the pointwise product of the two functions."""
    return haar(ihaar(a) * ihaar(b))


def parent_sums(coefficients: npt.ArrayLike) -> Array:
    """psum(a; r, s) = Σ over coarser functions j' of sign(j') 2^(r' − R) a_j': the mean of a over each square.

    Returns
    -------
    means : (..., n_squares) float64, squares of levels 0 … levels − 1, coarse to fine
    """
    samples = ihaar(coefficients)
    levels = quadtree.levels_of(samples.shape[-1])
    means = [samples.reshape(*samples.shape[:-1], 4**r, -1).mean(axis=-1) for r in range(levels)]
    return np.concatenate(means, axis=-1) if means else np.empty((*samples.shape[:-1], 0))


def triple_tree(a: npt.ArrayLike, b: npt.ArrayLike, *, as_printed: bool = False) -> Array:
    """a ⊕ b through K_j and G_j, square by square, for one pair of coefficient vectors.

    With E(r, s) the sum of a_j b_j over all wavelets inside the square, its own three included::

        (a ⊕ b)_j = 2^(r−R) (a_j+ b_j− + a_j− b_j+) + a_j psum(b) + b_j psum(a) + G_j
        G_j       = 2^(r−R) Σ_children sign_M(c) E(c)

    The supplemental prints G_j with the factor 2^(r−r'), r' the level of the finer function. Its derivation
    loses the 2^(−R+r') that stands before the parent sum; with it the product of the two is 2^(r−R).
    `as_printed` evaluates the printed form: the counter-example that the tests keep.
    """
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    levels = quadtree.levels_of(a.shape[-1])
    sums_a, sums_b = parent_sums(a), parent_sums(b)
    energy = np.zeros(quadtree.n_squares(levels + 1))
    out = np.zeros_like(a)
    for level in reversed(range(levels)):
        own = 2.0 ** (level - levels)
        finer = 2.0 ** (level - (level + 1)) if as_printed else own
        # Printed, each finer level r' enters with 2^(r−r'): every level climbed halves what came from below.
        climbed = 0.5 if as_printed else 1.0
        for index in range(4**level):
            here = quadtree.square(level, index)
            below = energy[[quadtree.square(level + 1, 4 * index + c) for c in range(4)]]
            j = [quadtree.coefficient(level, index, m) for m in (1, 2, 3)]
            for m in range(3):
                plus, minus = j[(m + 1) % 3], j[(m + 2) % 3]
                out[j[m]] = (
                    own * (a[plus] * b[minus] + a[minus] * b[plus])
                    + a[j[m]] * sums_b[here]
                    + b[j[m]] * sums_a[here]
                    + finer * (quadtree.SIGNS[m] @ below)
                )
            energy[here] = a[j] @ b[j] + climbed * below.sum()
    root = energy[0] if levels else 0.0
    out[0] = 2.0**-levels * (a[0] * b[0] + root)
    return out


# --- directions ----------------------------------------------------------------------------------------------


def square_to_hemisphere(u: npt.ArrayLike, v: npt.ArrayLike) -> Array:
    """Unit square to hemisphere, equal areas: Shirley & Chiu's concentric disk, lifted by z = 1 − r².

    Parameters
    ----------
    u, v : (...) in [0, 1], along columns and rows

    Returns
    -------
    directions : (..., 3), z ≥ 0
    """
    a = 2.0 * np.asarray(u, dtype=np.float64) - 1.0
    b = 2.0 * np.asarray(v, dtype=np.float64) - 1.0
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    safe = np.where(radius == 0.0, 1.0, radius)
    angle = np.where(wide, np.pi / 4 * b / safe, np.pi / 2 - np.pi / 4 * a / safe)
    lift = radius * np.sqrt(2.0 - radius**2)
    return np.stack([lift * np.cos(angle), lift * np.sin(angle), 1.0 - radius**2], axis=-1)


def hemisphere_to_square(directions: npt.ArrayLike) -> tuple[Array, Array]:
    """Inverse of `square_to_hemisphere`: (..., 3) with z ≥ 0 to u, v in [0, 1]."""
    d = np.asarray(directions, dtype=np.float64)
    radius = np.sqrt(np.maximum(1.0 - d[..., 2], 0.0))
    x, y = d[..., 0], d[..., 1]
    wide = np.abs(x) > np.abs(y)
    near = np.arctan2(np.where(wide, y, x), np.where(wide, np.abs(x), np.abs(y)) + 1e-300) * (4 / np.pi)
    a = np.where(wide, np.copysign(1.0, x), near) * radius
    b = np.where(wide, near, np.copysign(1.0, y)) * radius
    return (a + 1.0) / 2.0, (b + 1.0) / 2.0


def directions(levels: int, offset: tuple[float, float] = (0.5, 0.5)) -> Array:
    """Directions of the samples in Morton order, each subtending 2π/4**levels sr: (4**levels, 3).

    `offset` places the sample inside its cell, (column, row) in [0, 1)²; the centre by default.
    """
    rows, columns = quadtree.morton_to_grid(levels)
    side = 1 << levels
    return square_to_hemisphere((columns + offset[0]) / side, (rows + offset[1]) / side)


def equirectangular(world: npt.ArrayLike) -> tuple[Array, Array]:
    """World directions to map coordinates: u = atan2(x, −z)/2π in [0, 1), v = acos(y)/π in [0, 1]."""
    d = np.asarray(world, dtype=np.float64)
    u = (np.arctan2(d[..., 0], -d[..., 2]) / (2 * np.pi)) % 1.0
    return u, np.arccos(np.clip(d[..., 1], -1.0, 1.0)) / np.pi


def environment(image: npt.ArrayLike, world: npt.ArrayLike) -> Array:
    """Radiance of an equirectangular map along world directions, bilinear, columns wrapping.

    Parameters
    ----------
    image : (h, 2 h, 3) radiance, row 0 at the zenith, texel centres at (i + 0.5)/h, (j + 0.5)/w
    world : (..., 3) unit

    Returns
    -------
    radiance : (..., 3) float64
    """
    texels = np.asarray(image, dtype=np.float64)
    height, width = texels.shape[:2]
    u, v = equirectangular(world)
    x, y = u * width - 0.5, np.clip(v * height - 0.5, 0.0, height - 1.0)
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    y1 = np.minimum(y0 + 1, height - 1)
    left, right = x0 % width, (x0 + 1) % width
    top = texels[y0, left] * (1 - fx) + texels[y0, right] * fx
    bottom = texels[y1, left] * (1 - fx) + texels[y1, right] * fx
    return np.asarray(top * (1 - fy) + bottom * fy)


def peaks(image: npt.ArrayLike, threshold: float, refine: int = 2) -> tuple[Array, Array]:
    """What a map holds above a radiance threshold, as one sample for every refined texel.

    A grid of directions cannot see a sun smaller than its cells; these samples can. `environment_below` is the
    rest: the two add up to the map.

    Parameters
    ----------
    image : (h, 2 h, 3)
    threshold : of the mean of the three channels
    refine : subtexels along a texel's side

    Returns
    -------
    directions : (n, 3) map directions
    irradiance : (n, 3) excess radiance times solid angle
    """
    texels = np.asarray(image, dtype=np.float64)
    height, width = texels.shape[0] * refine, texels.shape[1] * refine
    theta = np.pi * (np.arange(height) + 0.5) / height
    # Bilinear interpolation cannot exceed the texels around it: rows without a bright neighbour are passed over.
    bright = np.nonzero((texels.mean(axis=2) > threshold).any(axis=1))[0]
    rows = np.unique(np.clip(np.add.outer(bright * refine, np.arange(-refine, 2 * refine)), 0, height - 1))
    directions, irradiance = [np.empty((0, 3))], [np.empty((0, 3))]
    phi = 2 * np.pi * (np.arange(width) + 0.5) / width
    for row in rows:
        ring = np.stack(
            [
                np.sin(theta[row]) * np.sin(phi),
                np.full(width, np.cos(theta[row])),
                -np.sin(theta[row]) * np.cos(phi),
            ],
            axis=1,
        )
        radiance = environment(texels, ring)
        excess = radiance - _below(radiance, threshold)
        kept = excess.max(axis=1) > 0.0
        solid = (np.cos(np.pi * row / height) - np.cos(np.pi * (row + 1) / height)) * 2 * np.pi / width
        directions.append(ring[kept])
        irradiance.append(excess[kept] * solid)
    return np.concatenate(directions), np.concatenate(irradiance)


def environment_below(image: npt.ArrayLike, world: npt.ArrayLike, threshold: float) -> Array:
    """`environment` with what exceeds the threshold taken off, colour kept."""
    return _below(environment(image, world), threshold)


def _below(radiance: Array, threshold: float) -> Array:
    level = radiance.mean(axis=-1, keepdims=True)
    return np.asarray(radiance * np.minimum(1.0, threshold / np.maximum(level, 1e-300)))


# --- reflectance ---------------------------------------------------------------------------------------------


def half_angles(incident: Array, outgoing: Array) -> tuple[Array, Array]:
    """cos θ_h (half vector against the normal) and cos θ_d (half vector against either direction)."""
    half = incident + outgoing
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-300)
    return np.clip(half[..., 2], 0.0, 1.0), np.clip(np.sum(half * outgoing, axis=-1), 0.0, 1.0)


def fresnel_conductor(cosine: Array, eta: npt.ArrayLike, k: npt.ArrayLike) -> Array:
    """Exact unpolarised reflectance of a conductor of index eta − i k in air, from the complex Fresnel terms.

    Shapes broadcast: cosine (..., 1) with eta, k (3,).
    """
    index = np.asarray(eta, dtype=np.float64) - 1j * np.asarray(k, dtype=np.float64)
    transmitted = np.sqrt(1.0 - (1.0 - cosine**2) / index**2)  # complex Snell
    s = (cosine - index * transmitted) / (cosine + index * transmitted)
    p = (index * cosine - transmitted) / (index * cosine + transmitted)
    return np.asarray((np.abs(s) ** 2 + np.abs(p) ** 2) / 2.0)


def fresnel_schlick(cosine: Array, f0: npt.ArrayLike) -> Array:
    """Schlick's approximation F0 + (1 − F0)(1 − cos θ_d)⁵."""
    zero = np.asarray(f0, dtype=np.float64)
    return np.asarray(zero + (1.0 - zero) * (1.0 - cosine) ** 5)


def ggx_distribution(cosine_h: Array, alpha: float) -> Array:
    """D(h) = α² / (π (cos²θ_h (α² − 1) + 1)²), written without cancellation for small α."""
    sine2 = 1.0 - cosine_h**2
    return np.asarray(alpha**2 / (np.pi * (cosine_h**2 * alpha**2 + sine2) ** 2))


def smith_g1(cosine: Array, alpha: float) -> Array:
    """Smith's masking for GGX: 2 / (1 + √(1 + α² tan²θ))."""
    c2 = np.maximum(cosine, 1e-150) ** 2
    return np.asarray(2.0 / (1.0 + np.sqrt(1.0 + alpha**2 * (1.0 - c2) / c2)))


def brdf(material: dict[str, object], incident: Array, outgoing: Array) -> Array:
    """f in 1/sr, RGB, without the cosine; zero where either direction is below the horizon.

    Parameters
    ----------
    material : ``{"kind": "lambert", "albedo"}``, ``{"kind": "ggx", "alpha", "eta", "k"}`` or ``"f0"`` in place
        of the index, optionally ``"kd"``; ``{"kind": "blinn", "exponent", "ks", "kd"}``;
        ``{"kind": "table", "values", "theta_h", "theta_d"}``;
        ``{"kind": "measured", "values", "valid", "theta_h", "theta_d"}``, see `_measured`
    incident, outgoing : (..., 3), broadcast against each other

    Returns
    -------
    f : (..., 3) float64
    """
    incident, outgoing = np.broadcast_arrays(incident, outgoing)
    above = (incident[..., 2] > 0.0) & (outgoing[..., 2] > 0.0)
    cos_h, cos_d = half_angles(incident, outgoing)
    cos_i = np.where(above, incident[..., 2], 1.0)
    cos_o = np.where(above, outgoing[..., 2], 1.0)
    kind = material["kind"]
    grey = np.ones(3)
    if kind == "lambert":
        f = np.ones((*above.shape, 1)) * (np.asarray(material["albedo"]) * grey) / np.pi
    elif kind == "ggx":
        alpha = float(material["alpha"])  # type: ignore[arg-type]
        if material.get("f0") is None:
            fresnel = fresnel_conductor(cos_d[..., None], material["eta"] * grey, material["k"] * grey)  # type: ignore[operator]
        else:
            fresnel = fresnel_schlick(cos_d[..., None], np.asarray(material["f0"]) * grey)
        lobe = ggx_distribution(cos_h, alpha) * smith_g1(cos_i, alpha) * smith_g1(cos_o, alpha)
        f = (lobe / (4.0 * cos_i * cos_o))[..., None] * fresnel
        below = 1.0 - fresnel_schlick(cos_d[..., None], 0.04)  # what glTF's dielectric layer lets through
        f = f + below * (np.asarray(material.get("kd", 0.0)) * grey) / np.pi
    elif kind == "blinn":
        n = float(material["exponent"])  # type: ignore[arg-type]
        norm = (n + 2.0) * (n + 4.0) / (8.0 * np.pi * (n + 2.0 ** (-n / 2.0)))
        f = norm * (cos_h**n)[..., None] * (np.asarray(material["ks"]) * grey)
        f = f + (np.asarray(material.get("kd", 0.0)) * grey) / np.pi
    elif kind == "table":
        f = _table(material, np.arccos(cos_h), np.arccos(cos_d))
    elif kind == "measured":
        f = _measured(material, incident, outgoing)
    else:
        raise ValueError(f"material: unknown kind {kind!r}")
    return np.asarray(np.where(above[..., None], f, 0.0))


def _table(material: dict[str, object], theta_h: Array, theta_d: Array) -> Array:
    """Bilinear between the nodes of values[nh, nd, 3], clamped outside."""
    values = np.asarray(material["values"], dtype=np.float64)
    nodes = (np.asarray(material[key], dtype=np.float64) for key in ("theta_h", "theta_d"))
    corners = [_between(own, angle) for own, angle in zip(nodes, (theta_h, theta_d), strict=True)]
    return np.asarray(
        sum(values[i, j] * (wi * wj)[..., None] for (i, wi), (j, wj) in product(corners[0], corners[1]))
    )


def difference_angles(incident: Array, outgoing: Array) -> tuple[Array, Array, Array]:
    """θ_h, θ_d and φ_d as Rusinkiewicz (1998) defines them: d is i turned by −φ_h about z, then by −θ_h about y."""
    incident, outgoing = (d / np.linalg.norm(d, axis=-1, keepdims=True) for d in (incident, outgoing))
    half = incident + outgoing
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-300)
    phi_h = np.arctan2(half[..., 1], half[..., 0])
    theta_h = np.arctan2(np.hypot(half[..., 0], half[..., 1]), half[..., 2])
    x = incident[..., 0] * np.cos(phi_h) + incident[..., 1] * np.sin(phi_h)
    y = incident[..., 1] * np.cos(phi_h) - incident[..., 0] * np.sin(phi_h)
    x, z = (
        x * np.cos(theta_h) - incident[..., 2] * np.sin(theta_h),
        x * np.sin(theta_h) + incident[..., 2] * np.cos(theta_h),
    )
    return theta_h, np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def _measured(material: dict[str, object], incident: Array, outgoing: Array) -> Array:
    """Trilinear in (√θ_h, θ_d, φ_d) between samples values[nh, nd, np, 3], φ_d of sample k at (k + ½) π/np.

    Clamped in the thetas, periodic in φ_d. Of the eight samples about a pair of directions an invalid one counts 2⁻²⁰
    of a valid one.
    """
    values, valid = (np.asarray(material[key], dtype=np.float64) for key in ("values", "valid"))
    share, count = np.where(valid > 0, 1.0, 2.0**-20), values.shape[2]
    theta_h, theta_d, phi_d = difference_angles(incident, outgoing)
    roots = np.sqrt(np.asarray(material["theta_h"], dtype=np.float64))
    corners = [
        _between(roots, np.sqrt(theta_h)),
        _between(np.asarray(material["theta_d"], np.float64), theta_d),
    ]
    place = phi_d * count / np.pi - 0.5
    low = np.floor(place).astype(np.int64)
    turns = ((low % count, 1.0 - (place - low)), ((low + 1) % count, place - low))
    above, below = np.zeros((*phi_d.shape, 3)), np.zeros(phi_d.shape)
    for (i, wi), (j, wj), (k, wk) in product(*corners, turns):
        own = wi * wj * wk * share[i, j, k]
        above, below = above + own[..., None] * values[i, j, k], below + own
    return np.asarray(above / below[..., None])


def _between(nodes: Array, at: Array) -> tuple[tuple[npt.NDArray[np.int64], Array], ...]:
    """The two nodes about each place and their weights, clamped outside the nodes."""
    if nodes.size == 1:
        zero = np.zeros(at.shape, dtype=np.int64)
        return (zero, np.ones(at.shape)), (zero, np.zeros(at.shape))
    at = np.clip(at, nodes[0], nodes[-1])
    low = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2)
    weight = (at - nodes[low]) / (nodes[low + 1] - nodes[low])
    return (low, 1.0 - weight), (low + 1, weight)


def slice_samples(
    material: dict[str, object], view: npt.ArrayLike, levels: int, supersample: int = 1
) -> Array:
    """f_v with the cosine, averaged over each cell of the hemisphere: (4**levels, 3), Morton order.

    `supersample` levels finer samples are averaged per cell: 4**supersample a cell.
    """
    incident = directions(levels + supersample)
    values = brdf(material, incident, np.asarray(view, dtype=np.float64)) * incident[:, 2:3]
    return np.asarray(values.reshape(4**levels, 4**supersample, 3).mean(axis=1))


# --- radiance ------------------------------------------------------------------------------------------------


def radiance(
    image: npt.ArrayLike,
    material: dict[str, object],
    frame: npt.ArrayLike,
    view: npt.ArrayLike,
    *,
    levels: int,
    position: npt.ArrayLike = (0.0, 0.0, 0.0),
    occluded: Occluded | None = None,
    offset: tuple[float, float] = (0.5, 0.5),
) -> Array:
    """Equation (1) at one point as a sum over 4**levels directions, every factor exact in every direction.

    Parameters
    ----------
    image : (h, 2 h, 3) environment radiance
    frame : (3, 3) world tangent, bitangent, normal as rows
    view : (3,) world unit vector towards the eye
    occluded : rays' origins and directions (n, 3) float32 to (n,) bool; None is an unoccluded point
    offset : where in its cell each direction is taken

    Returns
    -------
    radiance : (3,)
    """
    axes = np.asarray(frame, dtype=np.float64)
    local = directions(levels, offset)
    world = local @ axes
    light = environment(image, world)
    if occluded is not None:
        origins = np.broadcast_to(np.asarray(position, dtype=np.float32), world.shape)
        hidden = occluded(np.ascontiguousarray(origins), world.astype(np.float32))
        light = np.where(hidden[:, None], 0.0, light)
    reflect = brdf(material, local, axes @ np.asarray(view, dtype=np.float64)) * local[:, 2:3]
    return np.asarray((light * reflect).sum(axis=0) * (2 * np.pi / local.shape[0]))
