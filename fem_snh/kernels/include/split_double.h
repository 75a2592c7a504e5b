/* A double as two halves of 32 bits: the nearest float, and the rest as a multiple of 2^-53 times the float's power of
 * two. Both together are exact: a double has 53 bits, of which the rest are at most 30 and a sign. The range is that of normal
 * floats: beyond it values are not finite, and above 2^127 and below 2^-126 the rest is lost. */
typedef float float4 __attribute__((vector_size(16), aligned(4)));
typedef int int4 __attribute__((vector_size(16), aligned(4)));
typedef double double4 __attribute__((vector_size(32), aligned(8)));

#define SPLIT static inline __attribute__((always_inline))
#define EXPONENT 0x7f800000 /* the bits of a float's exponent; 0x7f000000 less these are those of the inverse power */

/* Four values from their halves. */
SPLIT double4 join4(const float *high, const int *rest) {
  const float4 f = *(const float4 *)high, power = (float4)((int4)f & EXPONENT);
  const double4 unit = __builtin_convertvector(power, double4) * 0x1p-53;
  return __builtin_convertvector(f, double4) + __builtin_convertvector(*(const int4 *)rest, double4) * unit;
}

/* Store four values. */
SPLIT void split4(double4 v, float *high, int *rest) {
  const float4 f = __builtin_convertvector(v, float4), inverse = (float4)(0x7f000000 - ((int4)f & EXPONENT));
  const double4 units = (v - __builtin_convertvector(f, double4)) * (__builtin_convertvector(inverse, double4) * 0x1p53);
  *(float4 *)high = f;
  *(int4 *)rest = __builtin_convertvector(units, int4);
}

/* One value. */
SPLIT double join(float high, int rest) {
  const union { float f; int bits; } of = {.f = high}, power = {.bits = of.bits & EXPONENT};
  return high + rest * (power.f * 0x1p-53);
}

SPLIT void split(double v, float *high, int *rest) {
  const union { float f; int bits; } of = {.f = v}, inverse = {.bits = 0x7f000000 - (of.bits & EXPONENT)};
  *high = of.f;
  *rest = (v - of.f) * (inverse.f * 0x1p53);
}
