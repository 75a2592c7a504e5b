/* Divided differences of the stretches and their limits. */

/* numerator / denominator, or the limit where the denominator is too small beside its partner
 * (s_j - s_k beside s_j + s_k, or the other way round) for the division to keep its digits: the
 * trapezoidal limit errs by the square of that ratio, the division by its inverse times the
 * rounding, so both keep ten digits at 1e-5. */
INLINE real lane_quotient(real numerator, real denominator, real partner, real limit) {
  const mask close = absolute(denominator) <= 1e-5 * absolute(partner) + 1e-300;
  return select(close, limit, numerator / select(close, splat(1), denominator));
}

/* 1/(s_j + s_k) for I1 = tr S. Signed stretches come ordered, so the sum is not negative; where it
 * vanishes the polar rotation, and with it the Hessian, is undefined: finite there, and huge. */
INLINE real lane_inverse_sum(real a, real b) {
  return 1 / largest(a + b, 1e-15 * (absolute(a) + absolute(b)) + 1e-30);
}
