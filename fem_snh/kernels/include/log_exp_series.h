/* log(1 + x)/x, (exp(x) - 1)/x and ((1 + x)^a - 1)/x to a few roundings for every x, with their limits at
 * x = 0. A series where x is small, the common case here; the C library elsewhere. */

INLINE real lane_log1p_over_x(real x) {
  /* log(1 + x) = 2 atanh z with z = x/(2 + x): |z| < 0.15 here, so the omitted terms from z^20/21 on are
   * below double precision. */
  const mask small = absolute(x) <= 0.25;
  const real z = x / (2 + x), w = z * z;
  real sum = splat(1.0 / 19);
  for (int n = 17; n > 0; n -= 2) sum = sum * w + 1.0 / n;
  real quotient = 2 * sum / (2 + x);
  if (any(~small))
    for (int l = 0; l < W; ++l)
      if (!small[l]) quotient[l] = log1p(x[l]) / x[l];
  return quotient;
}

INLINE real lane_expm1_over_x(real x) {
  /* Taylor series of 14 terms: the omitted 0.5^14/15! is below double precision. */
  const mask small = absolute(x) <= 0.5;
  real quotient = splat(1);
  for (int n = 14; n > 1; --n) quotient = 1 + quotient * x / n;
  if (any(~small))
    for (int l = 0; l < W; ++l)
      if (!small[l]) quotient[l] = expm1(x[l]) / x[l];
  return quotient;
}

INLINE real lane_log1p(real x) { return x * lane_log1p_over_x(x); }
INLINE real lane_expm1(real x) { return x * lane_expm1_over_x(x); }

/* ((1 + x)^a - 1)/x = expm1(y)/x with y = a log(1 + x). */
INLINE real lane_powm1_over_x(real x, double a) {
  const real quotient = a * lane_log1p_over_x(x);
  return quotient * lane_expm1_over_x(quotient * x);
}
