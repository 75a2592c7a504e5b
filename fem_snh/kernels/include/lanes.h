/* SIMD lanes: a `real` holds W doubles, one per quadrature point or per cell; arithmetic acts on all
 * W at a time. The vector extensions of GCC and Clang compile to AVX-512, AVX2, SSE or NEON.
 *
 * W is the number of doubles in a register of the processor. Wider vectors would be kept in memory, with a load and a
 * store for each operation: with W = 8 on AVX2 energies take 4 times as long, Hessians twice. Results depend on W by
 * rounding at most. */
#if defined __AVX512F__
#define W 8
#elif defined __AVX__
#define W 4
#else
#define W 2
#endif
typedef double real __attribute__((vector_size(8 * W)));
typedef long long mask __attribute__((vector_size(8 * W))); /* -1 true, 0 false, lane by lane */

#define INLINE static inline __attribute__((always_inline))
/* A function compiled once, not at each call, which halves the time of compilation at no measurable cost. */
#define SHARED static __attribute__((noinline))
/* A function compiled once for all kernels (svd_eigen.h). */
#define LINKED __attribute__((noinline, visibility("hidden")))

INLINE real splat(double a) { return (real){0} + a; }
INLINE real select(mask m, real a, real b) { return (real)((m & (mask)a) | (~m & (mask)b)); }
INLINE real absolute(real a) { return (real)((mask)a & 0x7fffffffffffffffLL); }
INLINE real lane_max(real a, real b) { return select(a > b, a, b); }
INLINE real lane_min(real a, real b) { return select(a < b, a, b); }

/* The largest power of two <= a (a >= 0) and its inverse, both kept within the normal numbers: scaling
 * by a power of two is exact. */
INLINE void power_of_two(real a, real *power, real *inverse) {
  const mask low = (mask){0} + 0x0010000000000000LL, high = (mask){0} + 0x7fd0000000000000LL;
  mask exponent = (mask)a & 0x7ff0000000000000LL;
  exponent = (mask)select(exponent < low, (real)low, (real)exponent);
  exponent = (mask)select(exponent > high, (real)high, (real)exponent);
  *power = (real)exponent;
  *inverse = (real)(0x7fe0000000000000LL - exponent);
}

/* Whether the mask is true in at least one lane. */
INLINE int any(mask m) {
  long long some = 0;
  for (int l = 0; l < W; ++l) some |= m[l];
  return some != 0;
}

/* sqrt compiles to one vector instruction; the others call the C library lane by lane. */
#define LANEWISE(name, call)                       \
  INLINE real name(real a) {                       \
    for (int l = 0; l < W; ++l) a[l] = call(a[l]); \
    return a;                                      \
  }
LANEWISE(lane_sqrt, sqrt)
LANEWISE(lane_log, log)
LANEWISE(lane_exp, exp)
LANEWISE(lane_cbrt, cbrt)

INLINE real lane_pow(real a, double exponent) {
  for (int l = 0; l < W; ++l) a[l] = pow(a[l], exponent);
  return a;
}

/* A piecewise function: a where x > 0, else b. The other branch may be NaN. */
INLINE real lane_where(real x, real a, real b) { return select(x > 0, a, b); }

INLINE real dot(const real *a, const real *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

INLINE void cross(const real *a, const real *b, real *c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Load W of the caller's n matrices (9 doubles each) into lanes; lanes past the last matrix repeat it. */
INLINE void load_points(const double *F, long n, long start, real *lanes) {
  for (int l = 0; l < W; ++l) {
    const long at = start + l < n ? start + l : n - 1;
    for (int i = 0; i < 9; ++i) lanes[i][l] = F[9 * at + i];
  }
}

/* Store lanes into the caller's array, `size` doubles per point. */
#define STORE(out, size, lanes)                  \
  for (int l = 0; l < W && start + l < n; ++l)   \
    for (int i = 0; i < (size); ++i) (out)[(size) * (start + l) + i] = (lanes)[i][l];
