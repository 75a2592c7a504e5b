/* The C interface of the loop that returns stresses. The C compiler and, after cell_api.h, cffi read this one file. */

/* At the quadrature points of the cells: weights[cells][POINTS] times |det dx/dxi| [m^3], without `fractions`;
 * H = grad u [9][cells][POINTS] and the first Piola-Kirchhoff stress P [9][cells][POINTS] [Pa], components by columns.
 * If the element splits the volume term off, P = d(psi' + p J)/dF with the element's pressure p. */
void stresses_cells(const Cells *c, const double *u, const double *pressure, double *weights, double *H, double *P);
