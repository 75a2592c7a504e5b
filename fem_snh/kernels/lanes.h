/* W doubles that move together: the same code for W points, or for one point of W cells.
 *
 * GCC and Clang vector extensions; they become AVX-512, AVX2, SSE or NEON as the processor has it. */
#define W 8
typedef double real __attribute__((vector_size(8 * W)));
typedef long long mask __attribute__((vector_size(8 * W))); /* -1 true, 0 false, lane by lane */

#define INLINE static inline __attribute__((always_inline))

INLINE real splat(double a) { return (real){0} + a; }
INLINE real select(mask m, real a, real b) { return (real)((m & (mask)a) | (~m & (mask)b)); }
INLINE real absolute(real a) { return (real)((mask)a & 0x7fffffffffffffffLL); }
INLINE real largest(real a, real b) { return select(a > b, a, b); }
INLINE real smallest(real a, real b) { return select(a < b, a, b); }

INLINE int any(mask m) {
  long long some = 0;
  for (int l = 0; l < W; ++l) some |= m[l];
  return some != 0;
}

/* sqrt is one instruction; the others call the C library lane by lane. */
#define LANEWISE(name, call)                       \
  INLINE real name(real a) {                       \
    for (int l = 0; l < W; ++l) a[l] = call(a[l]); \
    return a;                                      \
  }
LANEWISE(lane_sqrt, sqrt)
LANEWISE(lane_log, log)
LANEWISE(lane_exp, exp)
LANEWISE(lane_cbrt, cbrt)
LANEWISE(lane_acos, acos)
LANEWISE(lane_cos, cos)

INLINE real lane_pow(real a, double exponent) {
  for (int l = 0; l < W; ++l) a[l] = pow(a[l], exponent);
  return a;
}

INLINE real dot(const real *a, const real *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

INLINE void cross(const real *a, const real *b, real *c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}
