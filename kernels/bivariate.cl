// SPDX-License-Identifier: MIT
// W_v of a bivariate table: the adjoint, which cells read which nodes, and those cells alone anew.
//
// Source: Sitthi-Amorn, Romeiro, Zickler, Lawrence: f_v = W_v f. A sample of f_v is, over the 4^SUB directions i of
// its cell (w_i their mean cosine; cell.clh, and brdf.cl makes them all),
//
//     f_v[cell] = 4^-SUB sum over i of w_i sum over the four nodes about (theta_h, theta_d)_i of b_i,node f[node]
//
// with b the bilinear weights, so  (W_v^T g)[node] = 4^-SUB sum over cells, i of w_i b_i,node g[cell].
//
//   table         n_h nodes of theta_h, n_d of theta_d, then n_h n_d 3 values (brdf.clh)
//   directions    4^(LEVELS+SUB) REAL4 of the local frame in Morton order; w is the mean cosine
//   views         REAL4 each, outgoing directions in the local frame
//   src           rows of CHANNELS 4^LEVELS REALs, g or a point's light times visibility
//   dst           rows of n_h n_d CHANNELS ACCs: a node's channels lie together
//
// No float atomics: a work-item owns its row of dst and adds in a fixed order, so two runs agree bit for bit.

#include "common.clh"
#include "quadtree.clh"
#include "brdf.clh"
#include "cell.clh"
#include "frame.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the slices>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

// The interval of nodes about a pair of directions: (h, d) its lower node, (wh, wd) the weights of its upper one.
inline int2 table_place(const global REAL *table, const int n_h, const int n_d, const REAL4 incident,
                        const REAL4 outgoing, REAL *wh, REAL *wd)
{
    const REAL2 angles = table_angles(incident, outgoing);
    return (int2)(interval(table, n_h, angles.x, wh), interval(table + n_h, n_d, angles.y, wd));
}

// Adds value to the four nodes about (h, d), each by its weight. Where an axis has one node both ends are that one.
inline void add_to_nodes(global ACC *dst, const int n_h, const int n_d, const int2 place, const REAL wh, const REAL wd,
                         const ACC *value)
{
    const int next_h = (n_h > 1) ? n_d * CHANNELS : 0, next_d = (n_d > 1) ? CHANNELS : 0;
    global ACC *at = dst + CHANNELS * (place.x * n_d + place.y);
    const ACC h1 = TO_ACC(wh), d1 = TO_ACC(wd), h0 = (ACC)1 - h1, d0 = (ACC)1 - d1;
    for (int c = 0; c < CHANNELS; ++c) {
        at[c] += h0 * d0 * value[c];
        at[c + next_d] += h0 * d1 * value[c];
        at[c + next_h] += h1 * d0 * value[c];
        at[c + next_h + next_d] += h1 * d1 * value[c];
    }
}

// dst row += scale sum over the points of the row of W_v^T src.
//
//   launch     n_rows work-items in x; row r has the points r per_row to (r + 1) per_row - 1
//   work       4^(LEVELS+SUB) angles (two arc tangents, two searches) a point; a cell whose src is zero costs nothing
//   rounding   a node's terms, N at most, each of 6 roundings, in order: |error| <= (N + 6) u_ACC sum |term|
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void table_adjoint(const global REAL *restrict table, const int n_h, const int n_d,
                   const global REAL4 *restrict directions, const global REAL4 *restrict views,
                   const global REAL *restrict src, const int per_row, const REAL scale, global ACC *restrict dst,
                   const int n_rows)
{
    const size_t row = get_global_id(0);
    if (row >= (size_t)n_rows)
        return;
    global ACC *out = dst + row * n_h * n_d * CHANNELS;
    for (size_t point = row * per_row; point < (row + 1) * per_row; ++point) {
        const REAL4 outgoing = views[point];
        if (!(outgoing.z > (REAL)0))
            continue;
        const global REAL *g = src + point * CHANNELS * N_SAMPLES(LEVELS);
        for (int cell = 0; cell < N_SAMPLES(LEVELS); ++cell) {
            int any = 0;
            for (int c = 0; c < CHANNELS; ++c)
                any |= g[c * N_SAMPLES(LEVELS) + cell] != (REAL)0;
            if (!any)
                continue;
            for (int i = 0; i < N_SAMPLES(SUB); ++i) {
                const REAL4 incident = directions[cell * N_SAMPLES(SUB) + i];
                REAL wh, wd;
                const int2 place = table_place(table, n_h, n_d, incident, outgoing, &wh, &wd);
                const ACC weight = TO_ACC(scale) * TO_ACC(incident.w) / N_SAMPLES(SUB);
                ACC value[CHANNELS];
                for (int c = 0; c < CHANNELS; ++c)
                    value[c] = weight * TO_ACC(g[c * N_SAMPLES(LEVELS) + cell]);
                add_to_nodes(out, n_h, n_d, place, wh, wd, value);
            }
        }
    }
}

// The same by nodes: a work-item a node and row, which looks for its own in all directions. For checking.
// Launch: n_h n_d work-items in x, n_rows in y.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void table_adjoint_plain(const global REAL *restrict table, const int n_h, const int n_d,
                         const global REAL4 *restrict directions, const global REAL4 *restrict views,
                         const global REAL *restrict src, const int per_row, const REAL scale,
                         global ACC *restrict dst)
{
    const int node = (int)get_global_id(0), h = node / n_d, d = node % n_d;
    const size_t row = get_global_id(1);
    if (node >= n_h * n_d)
        return;
    for (int c = 0; c < CHANNELS; ++c) {
        ACC sum = (ACC)0;
        for (size_t point = row * per_row; point < (row + 1) * per_row; ++point) {
            for (int i = 0; i < N_SAMPLES(LEVELS + SUB); ++i) {
                REAL wh, wd;
                const int2 place = table_place(table, n_h, n_d, directions[i], views[point], &wh, &wd);
                const REAL own_h = (h == place.x) ? (REAL)1 - wh : (h == place.x + 1) ? wh : (REAL)0;
                const REAL own_d = (d == place.y) ? (REAL)1 - wd : (d == place.y + 1) ? wd : (REAL)0;
                const size_t cell = (point * CHANNELS + c) * N_SAMPLES(LEVELS) + i / N_SAMPLES(SUB);
                if (views[point].z > (REAL)0)
                    sum += TO_ACC(own_h * own_d * directions[i].w * scale) * TO_ACC(src[cell]) / N_SAMPLES(SUB);
            }
        }
        dst[(row * n_h * n_d + node) * CHANNELS + c] += sum;
    }
}

// Hard light by the same adjoint: dst row += scale sum over points and lights of V max(n.omega, 0) b_node E (lights.cl).
//
//   lights     2 REAL4 each: world direction; irradiance at normal incidence, RGB
//   bits       rows of (n_lights + 31) / 32 uints a point, 1 is visible
//   frames     9 REALs a point: tangent, bitangent, normal
//   launch     n_rows work-items in x
//   rounding   as table_adjoint
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void table_adjoint_lights(const global REAL *restrict table, const int n_h, const int n_d,
                          const global REAL4 *restrict lights, const int n_lights, const global uint *restrict bits,
                          const global REAL *restrict frames, const global REAL4 *restrict views, const int per_row,
                          const REAL scale, global ACC *restrict dst, const int n_rows)
{
    const size_t row = get_global_id(0);
    if (row >= (size_t)n_rows)
        return;
    global ACC *out = dst + row * n_h * n_d * CHANNELS;
    for (size_t point = row * per_row; point < (row + 1) * per_row; ++point) {
        const global uint *visible = bits + point * ((n_lights + 31) / 32);
        const REAL4 outgoing = views[point];
        for (int l = 0; l < n_lights; ++l) {
            const REAL4 incident = to_local(frames + 9 * point, lights[2 * l]);
            if (!((visible[l / 32] >> (l % 32)) & 1u) || !(incident.z > (REAL)0) || !(outgoing.z > (REAL)0))
                continue;
            REAL wh, wd;
            const int2 place = table_place(table, n_h, n_d, incident, outgoing, &wh, &wd);
            const REAL4 energy = lights[2 * l + 1];
            const ACC each[3] = {TO_ACC(energy.x), TO_ACC(energy.y), TO_ACC(energy.z)};
            const ACC weight = TO_ACC(scale) * TO_ACC(incident.z);
            ACC value[CHANNELS];
            for (int c = 0; c < CHANNELS; ++c)
                value[c] = weight * each[c];
            add_to_nodes(out, n_h, n_d, place, wh, wd, value);
        }
    }
}

// Which nodes each cell reads: the lowest and highest node of theta_h, then of theta_d.
// Launch: 4^LEVELS work-items in x, views in y; dst 4 shorts a cell.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void table_cell_nodes(const global REAL *restrict table, const int n_h, const int n_d,
                      const global REAL4 *restrict directions, const global REAL4 *restrict views,
                      global short4 *restrict dst)
{
    const int cell = (int)get_global_id(0);
    const size_t view = get_global_id(1);
    if (cell >= N_SAMPLES(LEVELS))
        return;
    int2 low = (int2)(n_h, n_d), high = (int2)(0, 0);
    for (int i = 0; i < N_SAMPLES(SUB); ++i) {
        REAL wh, wd;
        const REAL4 incident = directions[cell * N_SAMPLES(SUB) + i];
        const int2 place = table_place(table, n_h, n_d, incident, views[view], &wh, &wd);
        low = min(low, place);
        high = max(high, min(place + 1, (int2)(n_h - 1, n_d - 1)));
    }
    dst[view * N_SAMPLES(LEVELS) + cell] = (short4)((short)low.x, (short)high.x, (short)low.y, (short)high.y);
}

// brdf_slices of some cells alone: `cells` holds view 4^LEVELS + cell of each, dst all rows of CHANNELS 4^LEVELS.
// Launch: n_cells work-items in x. The arithmetic is cell.clh's, so what is not listed need not be made anew.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void table_update_cells(const global int *restrict ints, const global REAL *restrict reals,
                        const global REAL *restrict tables, const global REAL4 *restrict directions,
                        const global REAL4 *restrict views, const global int *restrict cells,
                        global REAL *restrict dst, const int n_cells)
{
    if (get_global_id(0) >= (size_t)n_cells)
        return;
    const int at = cells[get_global_id(0)], view = at / N_SAMPLES(LEVELS), cell = at % N_SAMPLES(LEVELS);
    const REAL4 sum = cell_average(ints, reals, tables, directions + (size_t)cell * N_SAMPLES(SUB), views[view]);
    global REAL *out = dst + (size_t)view * CHANNELS * N_SAMPLES(LEVELS) + cell;
    out[0] = sum.x;
    if (CHANNELS == 3) {
        out[N_SAMPLES(LEVELS)] = sum.y;
        out[2 * N_SAMPLES(LEVELS)] = sum.z;
    }
}
