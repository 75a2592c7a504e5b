/* How the loops of cell_loops.h and stress_loops.h visit the cells, W at a time, and their quadrature points.
 *
 * One of volume_pointwise.h, volume_mean.h and volume_pressure.h precedes this file and defines how the
 * element treats the material's volume term:
 *   VolumeTerm ................ data of the volume term for W cells
 *   volume_prepare ............ compute these data at the displacement
 *   volume_parameters ......... the material's parameters at a point, with the pressure
 *   volume_energy_density ..... the energy density in addition to the material's
 *   volume_residual_point, volume_residual_add .... the residual in addition to B^T P
 *   volume_jacobian_point, volume_jacobian_add .... the Jacobian in addition to B^T C B */

/* Per batch of W cells: gather coordinates x and displacements v and prepare the volume term. The body and
 * its closing brace follow. */
#define FOR_EACH_BATCH                                         \
  for (long start = 0; start < c->cells; start += W) {         \
    const int lanes = c->cells - start < W ? c->cells - start : W; \
    long cell[W + 1];                                          \
    real x[GEOMETRY_NODES][3], v[NODES][3];                    \
    VolumeTerm volume;                                           \
    next_cells(c, start, cell);                                \
    const real fraction = cell_fractions(c, cell);             \
    GATHER(x, GEOMETRY_NODES, 3, c->geometry, c->x)            \
    GATHER_DISPLACEMENTS(v, c->nodes, u)                       \
    volume_prepare(c, fraction, cell, x, v, pressure, &volume);

/* Per quadrature point: the inverse I of dx/dxi, weight, H, F and the material's parameters p. The body and its
 * closing brace follow. */
#define FOR_EACH_POINT                                         \
  real I[9], weight, F[9], H[9];                                     \
  for (int q = 0; q < POINTS; ++q) {                           \
    geometry_point(c, x, fraction, q, I, &weight);             \
    deformation_point(c, q, I, v, F, H);                       \
    const Parameters p = volume_parameters(c, &volume, q);     \
    THIRD_STRETCH(p, F, H)
