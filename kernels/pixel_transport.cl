// SPDX-License-Identifier: MIT
// Transport of pixels over cells of the whole sphere that all of them share: V (+) f_v as rows of a matrix.
//
//     T_pc = (2 pi / 4^FINE) sum over the fine cells d of c of  V_pd  f_s(omega_d, v_s) max(n_s.omega_d, 0)
//
// The sub-pixel points s of pixel p take turns over the cells of the bits, s = first + (turn(b) + phase) mod count with
// turn as in prtcl/factors/pixel_visibility.py: V and f are those of one point, for at a silhouette their means apart
// are not the mean of their product. T is the mean over the pixel's points and over the cell together: equation (1) of
// Sitthi-Amorn et al. with light taken out, which is constant over c. Radiance is T times a column of light
// (pixel_product.cl).
//
//   ints, reals, tables   materials (brdf.clh)
//   material              one index a point
//   directions            2 4^FINE REAL4: world directions of the fine cells, upper hemisphere first, Morton order
//   bits                  rows of 2 4^BITS / 32 uints, one a pixel; bit b = d >> 2 (FINE - BITS) is fine cell d's
//   frames                9 REALs a point: tangent, bitangent, normal
//   views                 REAL4 a point, outgoing directions in the local frame
//   first, phase          n_pixels + 1 and n_pixels ints: each pixel's points, and which begins
//   cells                 n_cells ints: which cells of 2 4^LEVELS are wanted
//   dst                   CHANNELS planes of n_pixels rows of n_cells REALs
//   launch                n_cells work-items in x, n_pixels in y
//   work                  4^(FINE - LEVELS) evaluations of f a work-item (GGX: 100 flops)
//   rounding              4^(FINE - LEVELS) terms in order: |error| <= 4^(FINE - LEVELS) u times their sum

#include "common.clh"
#include "quadtree.clh"
#include "brdf.clh"
#include "frame.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the cells that light is constant over>"
#endif
#ifndef FINE
  #error "FINE: pass -D FINE=<levels of the cells that f is evaluated in, at least LEVELS and BITS>"
#endif
#ifndef BITS
  #error "BITS: pass -D BITS=<levels of the visibility grid, at least 2>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

// Derived
#define EACH N_SAMPLES(FINE - LEVELS)
#define WORDS (2 * N_SAMPLES(BITS) / 32)
#define TURN(d) ((d) ^ ((d) >> 4) ^ ((d) >> 8) ^ ((d) >> 12))

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void pixel_transport(const global int *restrict ints, const global REAL *restrict reals,
                     const global REAL *restrict tables, const global int *restrict material,
                     const global REAL4 *restrict directions, const global uint *restrict bits,
                     const global REAL *restrict frames, const global REAL4 *restrict views,
                     const global int *restrict first, const global int *restrict phase,
                     const global int *restrict cells, const int n_cells, const int n_pixels,
                     global REAL *restrict dst)
{
    const int at = (int)get_global_id(0);
    const size_t pixel = get_global_id(1);
    if (at >= n_cells)
        return;
    const int start = first[pixel], count = first[pixel + 1] - start, turn = phase[pixel];
    const global uint *visible = bits + pixel * WORDS;
    const int fine = cells[at] * EACH;
    REAL4 sum = (REAL4)((REAL)0);
    for (int i = 0; i < EACH; ++i) {
        const int d = fine + i, bit = d >> (2 * (FINE - BITS));
        const int point = start + (TURN(bit) + turn) % count;
        const REAL4 incident = to_local(frames + 9 * (size_t)point, directions[d]);
        if (((visible[bit / 32] >> (bit % 32)) & 1u) && incident.z > (REAL)0)
            sum += incident.z * brdf(ints + material[point] * MATERIAL_INTS, reals + material[point] * MATERIAL_REALS,
                                     tables, incident, views[point]);
    }
    sum *= (REAL)6.283185307179586477 / N_SAMPLES(FINE);
    global REAL *out = dst + pixel * n_cells + at;
    out[0] = sum.x;
    if (CHANNELS == 3) {
        out[(size_t)n_pixels * n_cells] = sum.y;
        out[2 * (size_t)n_pixels * n_cells] = sum.z;
    }
}
