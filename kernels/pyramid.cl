// SPDX-License-Identifier: MIT
// Parent sums of the product L (+) V, packed: the mean of L V over every square of the quadtree of a point.
//
// psum(a; r,s) of the reduced coefficients a is the mean of the product over square (r,s) (triple.cl). An inner product
// with a function that is constant on the leaves of a cut of the tree needs these and nothing else:
//
//     sum over j of a_j f_j  =  sum over leaves of f(leaf) * (samples in the leaf) * psum(a; leaf)
//
// A stage takes DEPTH levels: a work-item owns one square of level `top`, whose 4^DEPTH values are one contiguous run,
// packs the means of its squares of levels top + 1 ... top + DEPTH, and hands its own mean on. The last one also packs
// the root.
//
//   src      n_points * CHANNELS rows of 4^(top + DEPTH) REALs
//   means    n_points * CHANNELS rows of 4^top REALs, between stages
//   rows     n_points ints: the row of dst that each point's sums go to
//   dst      rows of N_SQUARES(LEVELS + 1) uints (shared_exponent.clh), square (r,s) at square_at(r, s)
//   scale    multiplies before packing, a power of two
//   launch   4^top work-items in x, points in y
//   work     4^DEPTH * 4/3 * CHANNELS additions, as many packings

#include "common.clh"
#include "quadtree.clh"
#include "shared_exponent.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the product>"
#endif
#ifndef DEPTH
  #error "DEPTH: pass -D DEPTH=1, 2 or 3, the levels of one stage"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

// Derived
#define RUN N_SAMPLES(DEPTH)

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void pack_means(const global REAL *restrict src, global REAL *restrict means, const global int *restrict rows,
                global uint *restrict dst, const int top, const REAL scale)
{
    const int index = (int)get_global_id(0);
    const size_t point = get_global_id(1);
    if (index >= N_SAMPLES(top))
        return;
    ACC x[CHANNELS][RUN];
    for (int c = 0; c < CHANNELS; ++c) {
        const global REAL *values = src + (point * CHANNELS + c) * N_SAMPLES(top + DEPTH) + (size_t)index * RUN;
        for (int i = 0; i < RUN; ++i)
            x[c][i] = (ACC)values[i];
    }
    global uint *out = dst + (size_t)rows[point] * N_SQUARES(LEVELS + 1);
    for (int depth = DEPTH; depth >= 0; --depth) {
        const int run = N_SAMPLES(depth);
        if (depth > 0 || top == 0)
            for (int i = 0; i < run; ++i) {
                const float r = (float)(scale * x[0][i]);
                const float g = (CHANNELS == 3) ? (float)(scale * x[CHANNELS / 2][i]) : r;
                const float b = (CHANNELS == 3) ? (float)(scale * x[CHANNELS - 1][i]) : r;
                out[square_at(top + depth, index * run + i)] = pack_rgb(r, g, b);
            }
        if (depth > 0)
            for (int c = 0; c < CHANNELS; ++c)
                for (int i = 0; i < run / 4; ++i)
                    x[c][i] = (ACC)0.25
                              * ((x[c][4 * i] + x[c][4 * i + 1]) + (x[c][4 * i + 2] + x[c][4 * i + 3]));
    }
    if (top > 0)
        for (int c = 0; c < CHANNELS; ++c)
            means[(point * CHANNELS + c) * N_SAMPLES(top) + index] = TO_REAL(x[c][0]);
}
