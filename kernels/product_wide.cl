// SPDX-License-Identifier: MIT
// Light times visibility for CPUs, with what follows it in the same pass: nothing between is ever stored.
//
// The environment is looked up sixteen cells at a time where visibility lets it pass (cube_wide.clh), and while those
// sixty-four products are in registers they are folded: into Haar coefficients (`light_times_visibility_reduced`), or
// into packed means (`light_times_visibility_packed`). The coarser levels follow from private memory. Arguments are
// those of product.cl and pyramid.cl, but for `directions`: three planes of 4^LEVELS REALs, x, y, z.
//
//   reduced   n_points * CHANNELS rows of 4^KEEP REALs: coefficients of L (+) V below KEEP
//   rows      n_points ints, sums: rows of N_SQUARES(LEVELS + 1) uints, scale: as in pyramid.cl
//   launch    n_points work-items in groups of one
//   private   CHANNELS * 4^(LEVELS-1) ACCs: LEVELS from 3 to 7
//   work      4^LEVELS look-ups of about 60 flops where light passes; 8/3 or 4/3 additions a cell and channel

#include "common.clh"
#include "quadtree.clh"
#include "wide.clh"
#include "cube_wide.clh"
#include "mask_wide.clh"
#include "keep_wide.clh"
#include "shared_exponent.clh"

// Problem constants
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

// The products of sixteen cells from `cell` on, in the channels' order.
inline void product16(const global REAL4 *cube, const int face, const global REAL *directions, const REAL *frame,
                      const global uint *words, const global REAL *weights, const int cell, ACC16 *product)
{
    const uint mask = mask16(words, cell);
    for (int c = 0; c < CHANNELS; ++c)
        product[c] = (ACC16)((ACC)0);
    if (mask == 0)
        return;
    REAL16 rgb[3];
    cube_lookup16(cube, face, frame, directions + cell, N_SAMPLES(LEVELS), mask, rgb);
    for (int c = 0; c < CHANNELS; ++c)
        product[c] = TO_ACC16(weight16(weights, cell) * rgb[c]);
}

#define LOAD_FRAME(frames, point)                        \
    REAL frame[9];                                       \
    for (int axis = 0; axis < 9; ++axis)                 \
        frame[axis] = (frames)[9 * (point) + axis];

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void light_times_visibility_reduced(const global REAL4 *restrict cube, const int face,
                                    const global REAL *restrict directions, const global REAL *restrict frames,
                                    const global uint *restrict bits, const global REAL *restrict weights,
                                    const global int *restrict grid, global REAL *restrict reduced)
{
    const size_t point = get_global_id(0);
    const global uint *words = bits + point * WORDS;
    const global REAL *weight = weights + (size_t)grid[point] * N_SAMPLES(BITS);
    global REAL *rows = reduced + point * CHANNELS * N_SAMPLES(KEEP);
    LOAD_FRAME(frames, point)
    ACC x[CHANNELS][N_SAMPLES(LEVELS - 1)];
    for (int cell = 0; cell < N_SAMPLES(LEVELS); cell += 64) {
        ACC16 p[4][CHANNELS];
        for (int k = 0; k < 4; ++k)
            product16(cube, face, directions, frame, words, weight, cell + 16 * k, p[k]);
        for (int c = 0; c < CHANNELS; ++c)
            vstore16(fold_kept(p[0][c], p[1][c], p[2][c], p[3][c], cell / 4, rows + c * N_SAMPLES(KEEP)), 0,
                     x[c] + cell / 4);
    }
    for (int c = 0; c < CHANNELS; ++c)
        fold_rest(x[c], rows + c * N_SAMPLES(KEEP));
}

// Sixteen colours to packed words (shared_exponent.clh), bit for bit as `pack_rgb` does.
inline uint16 pack_rgb16(const float16 r, const float16 g, const float16 b)
{
    const float16 top = fmin(fmax(fmax(r, g), fmax(b, 0.0f)), 65408.0f);
    // 2^(9 - e) with top < 2^e, built from the bits of top; half of it where top rounds up to the next power of two.
    const float16 own = as_float16((262 - (as_int16(fmax(top, 0x1p-16f)) >> 23)) << 23);
    const float16 steps = select(own, 0.5f * own, top * own + 0.5f >= 512.0f);
    const uint16 mr = convert_uint16(fmin(fmax(r, 0.0f) * steps + 0.5f, 511.0f));
    const uint16 mg = convert_uint16(fmin(fmax(g, 0.0f) * steps + 0.5f, 511.0f));
    const uint16 mb = convert_uint16(fmin(fmax(b, 0.0f) * steps + 0.5f, 511.0f));
    return mr | (mg << 9) | (mb << 18) | ((151u - (as_uint16(steps) >> 23)) << 27);
}

inline void pack16(const ACC16 *rgb, const REAL scale, global uint *at)
{
    const float16 r = convert_float16((ACC)scale * rgb[0]);
    const float16 g = (CHANNELS == 3) ? convert_float16((ACC)scale * rgb[CHANNELS / 2]) : r;
    const float16 b = (CHANNELS == 3) ? convert_float16((ACC)scale * rgb[CHANNELS - 1]) : r;
    vstore16(pack_rgb16(r, g, b), 0, at);
}

// Means of sixteen squares of four values.
inline ACC16 means16(const ACC16 a, const ACC16 b, const ACC16 c, const ACC16 d)
{
    return (ACC)0.5 * sums16(a, b, c, d);
}

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void light_times_visibility_packed(const global REAL4 *restrict cube, const int face,
                                   const global REAL *restrict directions, const global REAL *restrict frames,
                                   const global uint *restrict bits, const global REAL *restrict weights,
                                   const global int *restrict grid, const global int *restrict rows,
                                   global uint *restrict sums, const REAL scale)
{
    const size_t point = get_global_id(0);
    const global uint *words = bits + point * WORDS;
    const global REAL *weight = weights + (size_t)grid[point] * N_SAMPLES(BITS);
    global uint *out = sums + (size_t)rows[point] * N_SQUARES(LEVELS + 1);
    LOAD_FRAME(frames, point)
    ACC x[CHANNELS][N_SAMPLES(LEVELS - 1)];
    for (int cell = 0; cell < N_SAMPLES(LEVELS); cell += 64) {
        ACC16 p[4][CHANNELS];
        for (int k = 0; k < 4; ++k) {
            product16(cube, face, directions, frame, words, weight, cell + 16 * k, p[k]);
            pack16(p[k], scale, out + square_at(LEVELS, cell + 16 * k));
        }
        for (int c = 0; c < CHANNELS; ++c)
            vstore16(means16(p[0][c], p[1][c], p[2][c], p[3][c]), 0, x[c] + cell / 4);
    }
    for (int level = LEVELS - 1; level >= 2; --level)
        for (int i = 0; i < N_SAMPLES(level); i += 16) {
            ACC16 rgb[CHANNELS];
            for (int c = 0; c < CHANNELS; ++c)
                rgb[c] = vload16(0, x[c] + i);
            pack16(rgb, scale, out + square_at(level, i));
            if (level > 2 && i % 64 == 48)
                for (int c = 0; c < CHANNELS; ++c) {
                    const ACC *from = x[c] + i - 48;
                    vstore16(means16(vload16(0, from), vload16(1, from), vload16(2, from), vload16(3, from)), 0,
                             x[c] + i / 4 - 12);
                }
        }
    // The four squares of level 1 and the root.
    ACC4 last[CHANNELS];
    ACC root[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c) {
        const ACC16 v = vload16(0, x[c]);
        last[c] = (ACC)0.25 * ((v.s048c + v.s159d) + (v.s26ae + v.s37bf));
        root[c] = (ACC)0.25 * ((last[c].s0 + last[c].s1) + (last[c].s2 + last[c].s3));
    }
    for (int i = 0; i < 5; ++i) {
        float rgb[CHANNELS];
        for (int c = 0; c < CHANNELS; ++c)
            rgb[c] = (float)(scale * ((i == 0) ? root[c] : (i == 1) ? last[c].s0 : (i == 2) ? last[c].s1
                                      : (i == 3) ? last[c].s2 : last[c].s3));
        out[i] = pack_rgb(rgb[0], rgb[CHANNELS / 2], rgb[CHANNELS - 1]);
    }
}
