// SPDX-License-Identifier: MIT
// Reduced coefficients in place, at the cost of the squares in which visibility changes: the tree form of the product
// (triple.cl) where one factor is sparse.
//
// In a square that is all visible, a (+) V is a: nothing is read and nothing written. In one that is all hidden it is
// 0. Only a mixed square is opened: its children's values of a follow from its own (psum, top-down), and what they are
// after visibility folds into its new details and its own value (K, E and G at once, bottom-up), depth first:
//
//     values of the children      x_c = (m s_c0 + sum over M of s_cM d_M) / 2          s the signs of quadtree.clh
//     after visibility            y_c = x_c, 0, or what opening child c gives
//     new details and value       (m' d'_1 d'_2 d'_3) = butterfly(y) / 2
//
//   a         n_points * CHANNELS rows of 4^LEVELS REALs, coefficients; overwritten with a (+) V
//   bits      n_points rows of visibility words (visibility.cl), of a grid of LEVELS levels
//   launch    n_points work-items in groups of GROUP
//   work      about 50 flops a mixed square and channel; its three REALs read and written, hidden ones written

#include "common.clh"
#include "quadtree.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of a and of the visibility grid>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 1       // work-items a group
#endif

// Derived
#define WORDS (LEVELS < 3 ? 1 : N_SAMPLES(LEVELS) / 32)

#define HIDDEN 0
#define VISIBLE 1
#define MIXED 2

// What the run of 4^depth bits of square `index` holds.
inline int state_of(const global uint *words, const int depth, const int index)
{
    const int run = N_SAMPLES(depth), first = index * run;
    if (run < 32) {
        const uint all = (1u << run) - 1u;
        const uint own = (words[first >> 5] >> (first & 31)) & all;
        return (own == 0u) ? HIDDEN : (own == all) ? VISIBLE : MIXED;
    }
    const uint own = words[first >> 5];
    if (own != 0u && own != ~0u)
        return MIXED;
    for (int w = 1; w < run / 32; ++w)
        if (words[(first >> 5) + w] != own)
            return MIXED;
    return (own == 0u) ? HIDDEN : VISIBLE;
}

// The details of square (level, index) and all below it become 0, in every channel: runs of 3, 12, 48, 192 ... REALs.
inline void clear(global REAL *rows, const int level, const int index)
{
    for (int c = 0; c < CHANNELS; ++c) {
        global REAL *row = rows + c * N_SAMPLES(LEVELS);
        vstore3((JOIN(REAL, 3))((REAL)0), 0, row + coefficient_at(level, index));
        if (level + 1 < LEVELS) {
            global REAL *twelve = row + coefficient_at(level + 1, 4 * index);
            vstore8((JOIN(REAL, 8))((REAL)0), 0, twelve);
            vstore4((REAL4)((REAL)0), 2, twelve);
        }
        for (int at = level + 2; at < LEVELS; ++at) {
            const int run = N_SAMPLES(at - level);
            global REAL *details = row + coefficient_at(at, index * run);
            for (int i = 0; i < 3 * run; i += 16)
                vstore16((JOIN(REAL, 16))((REAL)0), 0, details + i);
        }
    }
}

// Values of a square's children in every channel.
inline void open(const global REAL *rows, const int level, const int index, const ACC *own, ACC4 *children)
{
    for (int c = 0; c < CHANNELS; ++c) {
        const global REAL *d = rows + c * N_SAMPLES(LEVELS) + coefficient_at(level, index);
        children[c] = (ACC)0.5 * butterfly((ACC4)(own[c], (ACC)d[0], (ACC)d[1], (ACC)d[2]));
    }
}

// A mixed square of the finest level, whose children are samples, in one go: `own` in and out as above.
inline void open_and_fold(global REAL *rows, const int index, const uint seen, ACC *own)
{
    for (int c = 0; c < CHANNELS; ++c) {
        global REAL *d = rows + c * N_SAMPLES(LEVELS) + coefficient_at(LEVELS - 1, index);
        const ACC4 x = (ACC)0.5 * butterfly((ACC4)(own[c], (ACC)d[0], (ACC)d[1], (ACC)d[2]));
        const ACC4 y = (ACC)0.5 * butterfly((ACC4)((seen & 1u) ? x.s0 : (ACC)0, (seen & 2u) ? x.s1 : (ACC)0,
                                                  (seen & 4u) ? x.s2 : (ACC)0, (seen & 8u) ? x.s3 : (ACC)0));
        d[0] = TO_REAL(y.s1);
        d[1] = TO_REAL(y.s2);
        d[2] = TO_REAL(y.s3);
        own[c] = y.s0;
    }
}

// And back: new details are stored, the square's own new value is left in `own`.
inline void fold(global REAL *rows, const int level, const int index, const ACC4 *children, ACC *own)
{
    for (int c = 0; c < CHANNELS; ++c) {
        global REAL *d = rows + c * N_SAMPLES(LEVELS) + coefficient_at(level, index);
        const ACC4 y = (ACC)0.5 * butterfly(children[c]);
        d[0] = TO_REAL(y.s1);
        d[1] = TO_REAL(y.s2);
        d[2] = TO_REAL(y.s3);
        own[c] = y.s0;
    }
}

inline ACC child_of(const ACC4 four, const int child)
{
    return (child == 0) ? four.s0 : (child == 1) ? four.s1 : (child == 2) ? four.s2 : four.s3;
}

inline ACC4 with_child(const ACC4 four, const int child, const ACC value)
{
    return (ACC4)(child == 0 ? value : four.s0, child == 1 ? value : four.s1, child == 2 ? value : four.s2,
                  child == 3 ? value : four.s3);
}

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void reduce_sparse(global REAL *restrict a, const global uint *restrict bits, const int n_points)
{
    const size_t point = get_global_id(0);
    if (point >= (size_t)n_points)
        return;
    const global uint *words = bits + point * WORDS;
    global REAL *rows = a + point * CHANNELS * N_SAMPLES(LEVELS);
    const int whole = state_of(words, LEVELS, 0);
    if (whole == VISIBLE)
        return;
    if (whole == HIDDEN) {
        clear(rows, 0, 0);
        for (int c = 0; c < CHANNELS; ++c)
            rows[c * N_SAMPLES(LEVELS)] = (REAL)0;
        return;
    }
    // Squares that are open, root first: values of their children, and the child that is next.
    ACC4 values[LEVELS][CHANNELS];
    int next[LEVELS];
    ACC own[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c)
        own[c] = (ACC)rows[c * N_SAMPLES(LEVELS)];
    int level = 0, index = 0;
    if (LEVELS == 1) {
        open_and_fold(rows, 0, words[0], own);
        level = -1;
    } else
        open(rows, 0, 0, own, values[0]);
    next[0] = 0;
    while (level >= 0) {
        if (level == LEVELS - 2) {      // children are the finest squares: all four at once
            const int first = 16 * index;
            const uint sixteen = words[first >> 5] >> (first & 31);
            for (int child = 0; child < 4; ++child) {
                const uint seen = (sixteen >> (4 * child)) & 15u;
                if (seen == 15u)
                    continue;
                for (int c = 0; c < CHANNELS; ++c)
                    own[c] = (seen == 0u) ? (ACC)0 : child_of(values[level][c], child);
                if (seen == 0u)
                    clear(rows, LEVELS - 1, 4 * index + child);
                else
                    open_and_fold(rows, 4 * index + child, seen, own);
                for (int c = 0; c < CHANNELS; ++c)
                    values[level][c] = with_child(values[level][c], child, own[c]);
            }
            next[level] = 4;
        }
        if (next[level] == 4) {         // done with this square: back to its parent
            fold(rows, level, index, values[level], own);
            const int child = index & 3;
            index >>= 2;
            --level;
            if (level >= 0)
                for (int c = 0; c < CHANNELS; ++c)
                    values[level][c] = with_child(values[level][c], child, own[c]);
            continue;
        }
        const int child = next[level]++;
        const int below = 4 * index + child;
        const int state = state_of(words, LEVELS - level - 1, below);
        if (state == HIDDEN) {
            for (int c = 0; c < CHANNELS; ++c)
                values[level][c] = with_child(values[level][c], child, (ACC)0);
            clear(rows, level + 1, below);
        } else if (state == MIXED) {
            for (int c = 0; c < CHANNELS; ++c)
                own[c] = child_of(values[level][c], child);
            ++level;
            index = below;
            open(rows, level, index, own, values[level]);
            next[level] = 0;
        }
    }
    for (int c = 0; c < CHANNELS; ++c)
        rows[c * N_SAMPLES(LEVELS)] = TO_REAL(own[c]);
}
