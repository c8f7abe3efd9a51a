// SPDX-License-Identifier: MIT
// Hard light of a mesh's points kept for editing: the visible energy of every node of a tree of light samples, and
// radiance over a cut of it.
//
//     I_p += sum over nodes of the cut of f(d_node, v) max(n.d_node, 0) E_p,node
//     E_p,node = sum over the node's lights of V_p(omega_l) E_l
//
// The visibility of each light is in E exactly; what a cut leaves out is f's variation over a node
// (prtcl/transport/hard_tree.py).
//
//   energies     n_lights REAL4 in the tree's order: irradiance at normal incidence, RGB
//   bits         rows of (n_lights + 31) / 32 uints, of the points collapsed now; 1 is visible
//   ranges       n_nodes int2: the lights of a node are first ... last - 1
//   rows         n_points ints: which of the mesh's points these are
//   sums         n_nodes rows of n_all uints (shared_exponent.clh), one column a point of the mesh; times `scale`
//   centres      n_nodes REAL4: the nodes' mean directions, world
//   list, starts the nodes of all cuts; a material's are list[starts[m]] ... list[starts[m + 1] - 1]
//   material, frames   of all points of the mesh; chosen, views  of the points wanted
//   dst          n_points REAL4, added to
//   work         hard_sums: the nodes' sizes together, some n_lights log n_lights bits a point; shade_hard_cut: about 100
//                flops (GGX) and 4 bytes of `sums` a node of the cut

#include "common.clh"
#include "brdf.clh"
#include "frame.clh"
#include "shared_exponent.clh"

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif
#ifndef LONG
  #define LONG 64       // nodes of a cut from which its sums do not stay in a CPU's caches between points
#endif

// Launch: n_points work-items in x, nodes in y.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void hard_sums(const global REAL4 *restrict energies, const int n_lights, const global uint *restrict bits,
               const global int2 *restrict ranges, const global int *restrict rows, global uint *restrict sums,
               const int n_all, const REAL scale, const int n_points)
{
    const int item = (int)get_global_id(0);
    const size_t node = get_global_id(1);
    if (item >= n_points)
        return;
    const global uint *visible = bits + (size_t)item * ((n_lights + 31) / 32);
    ACC4 sum = (ACC4)((ACC)0);
    for (int l = ranges[node].x; l < ranges[node].y; ++l)
        if ((visible[l / 32] >> (l % 32)) & 1u)
            sum += (ACC4)((ACC)energies[l].x, (ACC)energies[l].y, (ACC)energies[l].z, (ACC)0);
    sums[node * n_all + rows[item]] = pack_rgb((float)(sum.s0 * scale), (float)(sum.s1 * scale),
                                               (float)(sum.s2 * scale));
}

// Launch: n_points work-items in x.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void shade_hard_cut(const global int *restrict ints, const global REAL *restrict reals,
                    const global REAL *restrict tables, const global int *restrict material,
                    const global REAL4 *restrict centres, const global int *restrict list,
                    const global int *restrict starts, const global uint *restrict sums, const int n_all,
                    const global int *restrict chosen, const global REAL *restrict frames,
                    const global REAL4 *restrict views, global REAL4 *restrict dst, const REAL scale,
                    const int n_points)
{
    const int item = (int)get_global_id(0);
    if (item >= n_points)
        return;
    const int point = chosen[item], own = material[point];
    const global REAL *frame = frames + 9 * (size_t)point;
    const REAL4 outgoing = views[item];
    const int first = starts[own], last = starts[own + 1];
    const int far = last - first > LONG;
    ACC4 sum = (ACC4)((ACC)0);
    for (int k = first; k < last; ++k) {
        const int node = list[k];
        // Nodes' rows lie a mesh apart: of a long list the next one's is fetched ahead.
        if (far)
            prefetch(sums + (size_t)list[min(k + 1, last - 1)] * n_all + point, 1);
        const uint packed = sums[(size_t)node * n_all + point];
        const REAL4 incident = to_local(frame, centres[node]);
        const float4 energy = unpack_rgb(packed);
        if (!(incident.z > (REAL)0) || !(energy.x + energy.y + energy.z > 0.0f))
            continue;
        const REAL4 f = incident.z
                        * brdf(ints + own * MATERIAL_INTS, reals + own * MATERIAL_REALS, tables, incident, outgoing);
        sum += (ACC4)((ACC)f.x * (ACC)energy.x, (ACC)f.y * (ACC)energy.y, (ACC)f.z * (ACC)energy.z, (ACC)0);
    }
    sum *= (ACC)scale;
    dst[item] += (REAL4)(TO_REAL(sum.s0), TO_REAL(sum.s1), TO_REAL(sum.s2), (REAL)0);
}
