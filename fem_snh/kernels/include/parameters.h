/* The arguments of a generated function besides F: the material's constants, equal in all lanes, and the
 * pressure at the point [Pa], used by the energies of mixed elements only. */
typedef struct {
  const double *constants;
  real pressure;
} Parameters;
