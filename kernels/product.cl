// SPDX-License-Identifier: MIT
// The product of light and visibility in the pixel domain, and its block averages: the tree's honest rival.
//
// Haar of what this returns, times 2^(LEVELS-KEEP), is exactly the levels below KEEP of L (+) V: averaging over a
// cell is what truncating the product's levels does. Where the light dwarfs what passes, this is also the stable
// form: nothing is added that must cancel again.
//
//   light    n_points * CHANNELS rows of 4^LEVELS REALs
//   bits     n_points rows of visibility words (visibility.cl), of a grid of BITS <= LEVELS levels
//   dst      n_points * CHANNELS rows of 4^KEEP REALs, KEEP <= LEVELS
//   launch   4^KEEP work-items in x, n_points * CHANNELS rows in y
//   work     4^(LEVELS-KEEP) reads and additions a work-item

#include "common.clh"
#include "quadtree.clh"

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
