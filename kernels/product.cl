// SPDX-License-Identifier: MIT
// The product of light and visibility in the pixel domain, and its block averages: the tree's honest rival.
//
// Haar of what this returns, times 2^(LEVELS-KEEP), is exactly the levels below KEEP of L (+) V: averaging over a
// cell is what truncating the product's levels does. Where the light dwarfs what passes, this is also the stable
// form: nothing is added that must cancel again.
//
// light_times_visibility does the same straight from the environment, so that light which does not pass is never
// looked up and L_n is never stored. It also takes a weight for each ray: what f_v holds is the cosine averaged over a
// cell, what a ray stands for is the cosine where it went (prtcl/factors/hemisphere.py, `ray_weights`).
//
//   light    n_points * CHANNELS rows of 4^LEVELS REALs
//   bits     n_points rows of visibility words (visibility.cl), of a grid of BITS <= LEVELS levels
//   dst      n_points * CHANNELS rows of 4^KEEP REALs, KEEP <= LEVELS
//   launch   4^KEEP work-items in x, n_points * CHANNELS rows in y
//   work     4^(LEVELS-KEEP) reads and additions a work-item

#include "common.clh"
#include "quadtree.clh"
#include "frame.clh"
#include "cube.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the light>"
#endif
#ifndef BITS
  #error "BITS: pass -D BITS=<levels of the visibility grid, at most LEVELS>"
#endif
#ifndef KEEP
  #error "KEEP: pass -D KEEP=<levels kept, at most LEVELS>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=<rows of light per point>"
#endif

// Tunables
#ifndef SUB
  #define SUB 0         // levels of subsamples: 4^SUB look-ups a cell
#endif
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

// Derived
#define WORDS (BITS < 3 ? 1 : N_SAMPLES(BITS) / 32)
#define RUN N_SAMPLES(LEVELS - KEEP)

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void masked_average(const global REAL *restrict light, const global uint *restrict bits, global REAL *restrict dst)
{
    const int cell = (int)get_global_id(0);
    const size_t row = get_global_id(1);
    if (cell >= N_SAMPLES(KEEP))
        return;
    const global REAL *samples = light + row * N_SAMPLES(LEVELS) + (size_t)cell * RUN;
    const global uint *words = bits + (row / CHANNELS) * WORDS;
    ACC sum = (ACC)0;
    for (int i = 0; i < RUN; ++i) {
        const int bit = (cell * RUN + i) >> (2 * (LEVELS - BITS));
        if ((words[bit >> 5] >> (bit & 31)) & 1u)
            sum += (ACC)samples[i];
    }
    dst[row * N_SAMPLES(KEEP) + cell] = TO_REAL(sum * ((ACC)1 / RUN));
}

// The same from the soft cube (cube.clh): `directions` are 4^(LEVELS+SUB) REAL4 in Morton order, 4^SUB a cell; `frames`
// 9 REALs a point, on the cube's axes; `weights` rows of 4^BITS REALs and `grid` the row of each point. Launch: 4^KEEP
// work-items in x, points in y.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void light_times_visibility(const global REAL4 *restrict cube, const int face, const global REAL4 *restrict directions,
                            const global REAL *restrict frames, const global uint *restrict bits,
                            const global REAL *restrict weights, const global int *restrict grid,
                            global REAL *restrict dst)
{
    const int cell = (int)get_global_id(0);
    const size_t point = get_global_id(1);
    if (cell >= N_SAMPLES(KEEP))
        return;
    const global uint *words = bits + point * WORDS;
    const global REAL *weight = weights + (size_t)grid[point] * N_SAMPLES(BITS);
    ACC4 sum = (ACC4)((ACC)0);
    for (int i = 0; i < RUN; ++i) {
        const int sample = cell * RUN + i;
        const int bit = sample >> (2 * (LEVELS - BITS));
        if ((words[bit >> 5] >> (bit & 31)) & 1u)
            for (int k = 0; k < N_SAMPLES(SUB); ++k) {
                const REAL4 d = to_world(frames + 9 * point, directions[sample * N_SAMPLES(SUB) + k]);
                const REAL4 radiance = weight[bit] * cube_lookup(cube, face, d);
                sum += (ACC4)((ACC)radiance.x, (ACC)radiance.y, (ACC)radiance.z, (ACC)0);
            }
    }
    sum *= (ACC)1 / (RUN * N_SAMPLES(SUB));
    global REAL *out = dst + point * CHANNELS * N_SAMPLES(KEEP) + cell;
    out[0] = TO_REAL(sum.s0);
    if (CHANNELS == 3) {
        out[N_SAMPLES(KEEP)] = TO_REAL(sum.s1);
        out[2 * N_SAMPLES(KEEP)] = TO_REAL(sum.s2);
    }
}
