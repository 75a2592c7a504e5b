/* Divided differences of the stretches. */

/* numerator / denominator; where the denominator is small beside its partner (s_j - s_k beside
 * s_j + s_k, or the other way round) the same without a division by it (kernels/codegen/divided_differences.py). */
INLINE real lane_quotient(real numerator, real denominator, real partner, real divided) {
  const mask close = absolute(denominator) <= 0.1 * absolute(partner);
  return select(close, divided, numerator / select(close, splat(1), denominator));
}

/* 1/(s_j + s_k), of what has no limit where that vanishes, as for I1 = tr S. Signed stretches come
 * ordered, so the sum is not negative; where it vanishes the polar rotation, and with it the Hessian,
 * is undefined: finite there, and huge. */
INLINE real lane_inverse_sum(real a, real b) {
  return 1 / largest(a + b, 1e-15 * (absolute(a) + absolute(b)) + 1e-30);
}
