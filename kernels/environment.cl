// SPDX-License-Identifier: MIT
// The environment in each point's own frame: L_n = R_n L, averaged over the cells of the hemisphere.
//
// The environment comes in two parts that add up to it: a soft map, prefiltered onto a cube at the spacing of the
// samples below, which is gathered; and hard samples, a direction and an irradiance each, which are either shaded
// exactly (shade.cl) or added here to the cell they fall in. Their energy is then kept whatever the resolution:
// a cell's radiance grows by E / (2 pi / 4^LEVELS).
//
//   cube        6 faces (+x -x +y -y +z -z) of (face + 2)^2 REAL4 with one texel of border
//   directions  4^(LEVELS+SUB) REAL4 of the local frame in Morton order: 4^SUB a cell
//   frames      9 REALs a point: tangent, bitangent, normal
//   lights      2 REAL4 a hard sample: direction; irradiance at normal incidence (RGB)
//   dst         n_points * CHANNELS rows of 4^LEVELS REALs
//   launch      4^LEVELS work-items in x, points in y
//   work        about 60 flops and 4 REAL4 reads a lookup, 4^SUB lookups a cell

#include "common.clh"
#include "quadtree.clh"
#include "hemisphere.clh"
#include "frame.clh"
#include "cube.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the hemisphere grid>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

// Tunables
#ifndef SUB
  #define SUB 1         // levels of subsamples: 4^SUB lookups a cell
#endif
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void environment_gather(const global REAL4 *restrict cube, const int face, const global REAL4 *restrict directions,
                        const global REAL *restrict frames, global REAL *restrict dst)
{
    const int cell = (int)get_global_id(0);
    const size_t point = get_global_id(1);
    if (cell >= N_SAMPLES(LEVELS))
        return;
    const global REAL *frame = frames + 9 * point;
    REAL4 sum = (REAL4)((REAL)0);
    for (int i = 0; i < N_SAMPLES(SUB); ++i)
        sum += cube_lookup(cube, face, to_world(frame, directions[cell * N_SAMPLES(SUB) + i]));
    sum *= (REAL)1 / N_SAMPLES(SUB);
    global REAL *out = dst + point * CHANNELS * N_SAMPLES(LEVELS) + cell;
    out[0] = sum.x;
    if (CHANNELS == 3) {
        out[N_SAMPLES(LEVELS)] = sum.y;
        out[2 * N_SAMPLES(LEVELS)] = sum.z;
    }
}

// Add hard samples to their cells. One work-item a point, lights in order: no two write the same cell at once.
// Launch: n_points work-items in x.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void environment_splat(const global REAL4 *restrict lights, const int n_lights, const global REAL *restrict frames,
                       global REAL *restrict dst, const int n_points)
{
    const size_t point = get_global_id(0);
    if (point >= (size_t)n_points)
        return;
    const REAL density = (REAL)N_SAMPLES(LEVELS) * ((REAL)0.5 * INV_PI);     // 1 / cell's solid angle
    global REAL *out = dst + point * CHANNELS * N_SAMPLES(LEVELS);
    for (int l = 0; l < n_lights; ++l) {
        const REAL4 d = to_local(frames + 9 * point, lights[2 * l]);
        if (d.z > (REAL)0) {
            const int cell = cell_of(d, LEVELS);
            const REAL4 radiance = lights[2 * l + 1] * density;
            out[cell] += radiance.x;
            if (CHANNELS == 3) {
                out[N_SAMPLES(LEVELS) + cell] += radiance.y;
                out[2 * N_SAMPLES(LEVELS) + cell] += radiance.z;
            }
        }
    }
}
