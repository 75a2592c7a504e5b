/* The function of point_fields_api.h, W points at a time. */

/* Load component i of W of n points; lanes past the last point repeat it. */
INLINE real load_component(const double *values, long n, long start, int i) {
  real lanes;
  for (int l = 0; l < W; ++l) lanes[l] = values[n * i + (start + l < n ? start + l : n - 1)];
  return lanes;
}

#define STORE_FIELD(field, size, lanes) \
  if (out->field) { STORE(out->field, size, lanes) }

/* The fields of the Cauchy stress, from its entries s = {00, 11, 22, 01, 02, 12}. */
INLINE void stress_fields(long n, long start, const real *F, const real *P, const PointFields *out) {
  real area[3];
  cross(F + 3, F + 6, area);
  const real J = dot(F, area), over_J = 1 / select(J == 0, splat(NAN), J);
  real s[6];
  for (int k = 0; k < 6; ++k) {
    const int i = k < 3 ? k : k < 5 ? 0 : 1, j = k < 3 ? k : k < 4 ? 1 : 2;
    s[k] = (P[i] * F[j] + P[3 + i] * F[3 + j] + P[6 + i] * F[6 + j]) * over_J;
  }
  const real tensor[9] = {s[0], s[3], s[4], s[3], s[1], s[5], s[4], s[5], s[2]};
  STORE_FIELD(cauchy_stress, 9, tensor)
  if (out->von_mises) {
    const real d[3] = {s[0] - s[1], s[1] - s[2], s[2] - s[0]};
    const real von_mises = lane_sqrt(0.5 * dot(d, d) + 3 * dot(s + 3, s + 3));
    STORE(out->von_mises, 1, &von_mises)
  }
  if (out->hydrostatic_stress) {
    const real mean = (s[0] + s[1] + s[2]) / 3;
    STORE(out->hydrostatic_stress, 1, &mean)
  }
  if (out->principal_stresses) {
    real values[3], vectors[9];
    eigen3(CUBIC, s, values, vectors); /* zero where s is NaN */
    for (int k = 0; k < 3; ++k) values[k] = select(J == 0, splat(NAN), values[k]);
    STORE(out->principal_stresses, 3, values)
  }
}

void point_fields(long n, const double *H, const double *P, const PointFields *out) {
  const int cauchy = out->cauchy_stress || out->von_mises || out->principal_stresses || out->hydrostatic_stress;
  for (long start = 0; start < n; start += W) {
    real h[9], p[9], F[9], tensor[9];
    for (int i = 0; i < 9; ++i) {
      h[i] = load_component(H, n, start, i);
      p[i] = load_component(P, n, start, i);
      F[i] = h[i] + (i % 4 == 0);
    }
    if (cauchy) stress_fields(n, start, F, p, out);
    if (out->pk1_stress) {
      for (int i = 0; i < 9; ++i) tensor[i] = p[3 * (i % 3) + i / 3];
      STORE(out->pk1_stress, 9, tensor)
    }
    if (out->green_lagrange_strain) {
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
          tensor[3 * i + j] = 0.5 * (h[3 * j + i] + h[3 * i + j] + dot(h + 3 * i, h + 3 * j));
      STORE(out->green_lagrange_strain, 9, tensor)
    }
    if (out->principal_stretches) {
      real U[9], stretches[3], V[9];
      svd(F, U, stretches, V);
      STORE(out->principal_stretches, 3, stretches)
    }
  }
}
