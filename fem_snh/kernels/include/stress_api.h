/* The C interface of the loop that returns stresses, read by the C compiler and, after cell_api.h, by cffi. */

/* At the quadrature points of the cells: weights[cells][POINTS] times |det dx/dxi| [m^3], without the fractions, H = grad u
 * [9][cells][POINTS] and the first Piola-Kirchhoff stress P [9][cells][POINTS] [Pa], their components by columns.
 * Where the element splits the volume term off, P = d(psi' + p J)/dF with the element's own pressure p. */
void stresses_cells(const Cells *c, const double *u, const double *pressure, double *weights, double *H, double *P);
