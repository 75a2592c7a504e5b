/* What a generated function knows besides F: the material's constants, the same everywhere, and the
 * pressure of a mixed element at its point, which other materials never look at. */
typedef struct {
  const double *constants;
  real pressure;
} Law;
