/* A material's kernels at n deformation gradients F[n][9] (stored by columns). The C compiler and cffi read this one
 * file. `constants` are the material's constants [Pa]; `filter` and `solver` are positions in
 * fem_snh.choices.POINT_FILTERS and EIGENSOLVERS. */

/* psi[n] [Pa]; +inf outside the energy's domain. */
void energy_points(const double *constants, long n, const double *F, double *psi);
/* First Piola-Kirchhoff stress P[n][9] [Pa], by columns. */
void stress_points(const double *constants, long n, const double *F, double *P);
/* Filtered Hessian C[n][81] [Pa] on vec(F). */
void hessian_points(const double *constants, long n, const double *F, int filter, int solver, double *C);
/* Eigenvalues [n][9] [Pa] and eigenvectors [n][9][9], one after the other, of the exact Hessian. */
void eigensystem_points(const double *constants, long n, const double *F, int solver, double *values, double *vectors);
