/* log(1 + x)/x, (exp(x) - 1)/x and ((1 + x)^a - 1)/x, to a few roundings for every x; at x = 0 their
 * limits. Series where x is small, which is where they are asked for, and the C library elsewhere. */

INLINE real lane_log_slope(real x) {
  /* log(1 + x) = 2 atanh z, z = x/(2 + x): |z| < 0.15 here, and z^18 is below the rounding. */
  const mask small = absolute(x) <= 0.25;
  const real z = x / (2 + x), w = z * z;
  real sum = splat(1.0 / 19);
  for (int n = 17; n > 0; n -= 2) sum = sum * w + 1.0 / n;
  real slope = 2 * sum / (2 + x);
  if (any(~small))
    for (int l = 0; l < W; ++l)
      if (!small[l]) slope[l] = log1p(x[l]) / x[l];
  return slope;
}

INLINE real lane_exp_slope(real x) {
  const mask small = absolute(x) <= 0.5;
  real slope = splat(1);
  for (int n = 14; n > 1; --n) slope = 1 + slope * x / n;
  if (any(~small))
    for (int l = 0; l < W; ++l)
      if (!small[l]) slope[l] = expm1(x[l]) / x[l];
  return slope;
}

INLINE real lane_log1p(real x) { return x * lane_log_slope(x); }
INLINE real lane_expm1(real x) { return x * lane_exp_slope(x); }

INLINE real lane_power_slope(real x, double a) {
  const real slope = a * lane_log_slope(x);
  return slope * lane_exp_slope(slope * x);
}
