/* The functions of material_point.h and of the element's volume term, which are compiled once for each energy and
 * linked with the loops over points or cells. */

/* psi at F = I + H [Pa]. */
LINKED void energy_point(Parameters p, const real *F, const real *H, real *psi);
/* The first Piola-Kirchhoff stress P = dpsi/dF [Pa] at F = I + H. */
LINKED void stress_point(Parameters p, const real *F, const real *H, real *P);
/* The filtered 9x9 Hessian C of psi [Pa] (row-major, on vec(F)). Returns the lanes where the exact Hessian has a
 * negative eigenvalue. */
LINKED mask hessian_point(Parameters p, const real *F, int filter, int solver, real *C);
/* The nine eigenvalues e of the Hessian, the eigenvectors Q of the scaling block, and U and V of the SVD of F. */
LINKED void eigenvalues_point(Parameters p, const real *F, int solver, real *e, real *Q, real *U, real *V);

/* U, U' and U'' of the volume term [Pa] at J = 1 + change: volume_mean.h. */
LINKED void volume_energy(Parameters p, real J, real change, real *U);
/* The conjugate U*, d(U*)/dp - 1 and d2(U*)/dp2 at the pressure p.pressure: volume_pressure.h. */
LINKED void volume_conjugate(Parameters p, real *conjugate);

/* The eigenvalue e after the filter: unchanged (EXACT), absolute value (ABS), else max(e, 0). */
INLINE real filter_eigenvalue(int filter, real e) {
  return filter == EXACT ? e : filter == ABS ? absolute(e) : lane_max(e, splat(0));
}
