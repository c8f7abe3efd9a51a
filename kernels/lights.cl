// SPDX-License-Identifier: MIT
// Hard light: the few directions that hold an environment's peaks, shaded with the exact BRDF.
//
//     I_p += sum over l of V_p(omega_l) f(omega_l, v) max(n.omega_l, 0) E_l
//
//   ints, reals, tables   materials (brdf.clh)
//   material              one index a point
//   lights                2 REAL4 each: world direction; irradiance at normal incidence, RGB
//   bits                  rows of (n_lights + 31) / 32 uints, 1 is visible
//   frames                9 REALs a point: tangent, bitangent, normal
//   views                 n_points REAL4, outgoing directions in the local frame
//   dst                   n_points REAL4, added to
//   launch                n_points work-items
//   work                  about 100 flops a visible light (GGX)
//   rounding              n_lights terms in order: |error| <= n_lights u sum |term|

#include "common.clh"
#include "brdf.clh"
#include "frame.clh"

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void shade_lights(const global int *restrict ints, const global REAL *restrict reals,
                  const global REAL *restrict tables, const global int *restrict material,
                  const global REAL4 *restrict lights, const int n_lights, const global uint *restrict bits,
                  const global REAL *restrict frames, const global REAL4 *restrict views, global REAL4 *restrict dst,
                  const int n_points)
{
    const size_t point = get_global_id(0);
    if (point >= (size_t)n_points)
        return;
    const global REAL *frame = frames + 9 * point;
    const global uint *visible = bits + point * ((n_lights + 31) / 32);
    const global int *own_ints = ints + material[point] * MATERIAL_INTS;
    const global REAL *own_reals = reals + material[point] * MATERIAL_REALS;
    const REAL4 outgoing = views[point];
    ACC4 sum = (ACC4)((ACC)0);
    for (int l = 0; l < n_lights; ++l) {
        if (!((visible[l / 32] >> (l % 32)) & 1u))
            continue;
        const REAL4 incident = to_local(frame, lights[2 * l]);
        const REAL4 f = incident.z * brdf(own_ints, own_reals, tables, incident, outgoing) * lights[2 * l + 1];
        sum += (ACC4)((ACC)f.x, (ACC)f.y, (ACC)f.z, (ACC)0);
    }
    dst[point] += (REAL4)(TO_REAL(sum.s0), TO_REAL(sum.s1), TO_REAL(sum.s2), (REAL)0);
}
