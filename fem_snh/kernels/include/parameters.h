/* The arguments of a generated function besides F: the material's constants [Pa], equal in all lanes, and the
 * pressure at the point [Pa], which only the energies of mixed elements use. */
typedef struct {
  const double *constants;
  real pressure;
} Parameters;
