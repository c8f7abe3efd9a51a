// SPDX-License-Identifier: MIT
// Hard light of many environments on pixels: each light sample meets one sub-pixel point, which take turns.
//
//     I[p, c, e] += sum over l of environment e  V_pl f_s(omega_l, v_s) max(n_s.omega_l, 0) E_lc,
//     s = first + (turn + phase) mod count
//
// A sun is tens of samples, so its penumbra, the pixel's area and the lobe over both are sampled together. Weak lights
// have no ray of their own: V f is then bilinear between four cells of the soft light's grid, each with its own bit and
// the point that this is of (pixel_transport.cl), and so changes smoothly where the light turns.
//
//   ints, reals, tables   materials (brdf.clh)
//   material              one index a point
//   lights                2 REAL4 each: world direction; irradiance at normal incidence, RGB
//   turns, begin          one int a light; n_environments + 1 ints: the lights of each environment
//   bits                  a row of `words` uints a pixel, 1 is visible
//   soft                  a row of `soft_words` uints a pixel, the soft light's visibility
//   corners, weights      4 ints and REAL4 a light: cells of `soft` and their shares; -1 for lights that `bits` are of
//   frames                9 REALs a point: tangent, bitangent, normal
//   views                 REAL4 a point, outgoing directions in the local frame
//   first, phase          n_pixels + 1 and n_pixels ints: each pixel's points, and which begins
//   dst                   n_pixels rows of three planes of `stride` REALs, added to
//   launch                n_pixels work-items in x, environments in y
//   work                  about 100 flops a visible light (GGX)
//   rounding              as many terms as an environment has lights, in order: |error| <= n u sum |term|

#include "common.clh"
#include "brdf.clh"
#include "frame.clh"

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

#define TURN(d) ((d) ^ ((d) >> 4) ^ ((d) >> 8) ^ ((d) >> 12))

inline int bit_of(const global uint *row, const int bit)
{
    return (int)((row[bit / 32] >> (bit % 32)) & 1u);
}

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void pixel_lights(const global int *restrict ints, const global REAL *restrict reals,
                  const global REAL *restrict tables, const global int *restrict material,
                  const global REAL4 *restrict lights, const global int *restrict turns,
                  const global int *restrict begin, const global uint *restrict bits, const int words,
                  const global uint *restrict soft, const int soft_words, const global int4 *restrict corners,
                  const global REAL4 *restrict weights,
                  const global REAL *restrict frames, const global REAL4 *restrict views,
                  const global int *restrict first, const global int *restrict phase, const int n_pixels,
                  const int stride, global REAL *restrict dst)
{
    const size_t pixel = get_global_id(0);
    const int environment = (int)get_global_id(1);
    if (pixel >= (size_t)n_pixels)
        return;
    const int start = first[pixel], count = first[pixel + 1] - start, turn = phase[pixel];
    const global uint *visible = bits + pixel * words, *around = soft + pixel * soft_words;
    ACC4 sum = (ACC4)((ACC)0);
    for (int l = begin[environment]; l < begin[environment + 1]; ++l) {
        const int4 corner = corners[l];
        const REAL4 weight = weights[l];
        const int cells[4] = {corner.x, corner.y, corner.z, corner.w};
        const REAL shares[4] = {weight.x, weight.y, weight.z, weight.w};
        const int own = corner.x < 0;
        REAL4 f = (REAL4)((REAL)0);
        for (int c = 0; c < (own ? 1 : 4); ++c) {
            if (!(own ? bit_of(visible, l) : bit_of(around, cells[c])))
                continue;
            const int point = start + ((own ? turns[l] : TURN(cells[c])) + turn) % count;
            const REAL4 incident = to_local(frames + 9 * (size_t)point, lights[2 * l]);
            const REAL share = (own ? (REAL)1 : shares[c]) * fmax(incident.z, (REAL)0);
            if (share > (REAL)0)
                f += share * brdf(ints + material[point] * MATERIAL_INTS, reals + material[point] * MATERIAL_REALS,
                                  tables, incident, views[point]);
        }
        f *= lights[2 * l + 1];
        sum += (ACC4)((ACC)f.x, (ACC)f.y, (ACC)f.z, (ACC)0);
    }
    global REAL *out = dst + pixel * 3 * stride + environment;
    out[0] += TO_REAL(sum.s0);
    out[stride] += TO_REAL(sum.s1);
    out[2 * stride] += TO_REAL(sum.s2);
}
