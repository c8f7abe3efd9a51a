// SPDX-License-Identifier: MIT
// environment_gather for CPUs: sixteen cells at a time (cube_wide.clh), one look-up a cell.
//
//   directions  three planes of 4^LEVELS REALs: x, y, z
//   launch      n_points work-items in groups of one; all else as in environment.cl, LEVELS at least 2

#include "common.clh"
#include "quadtree.clh"
#include "wide.clh"
#include "cube_wide.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the hemisphere grid>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void environment_gather_wide(const global REAL4 *restrict cube, const int face, const global REAL *restrict directions,
                             const global REAL *restrict frames, global REAL *restrict dst)
{
    const size_t point = get_global_id(0);
    REAL frame[9];
    for (int axis = 0; axis < 9; ++axis)
        frame[axis] = frames[9 * point + axis];
    global REAL *out = dst + point * CHANNELS * N_SAMPLES(LEVELS);
    for (int cell = 0; cell < N_SAMPLES(LEVELS); cell += 16) {
        REAL16 rgb[3];
        cube_lookup16(cube, face, frame, directions + cell, N_SAMPLES(LEVELS), 0xffffu, rgb);
        for (int c = 0; c < CHANNELS; ++c)
            STREAM(rgb[c], (global REAL16 *)(out + c * N_SAMPLES(LEVELS) + cell));
    }
}
