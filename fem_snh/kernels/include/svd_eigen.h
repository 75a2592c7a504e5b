/* The functions of svd.h and eigen3.h, which are compiled once and linked with every kernel. */
LINKED void svd(const real *F, real *U, real *s, real *V);
LINKED void eigen3(int solver, const real *A, real *e, real *Q);
