/* The SVD and the eigensolvers at n points, without a material. The C compiler and cffi read this one file.
 * Matrices are stored by columns, F[n][9]; symmetric matrices as A[n][6] in the order of eigen3.h. */
void svd_points(long n, const double *F, double *U, double *s, double *V);
void eigen3_points(long n, const double *A, int solver, double *e, double *Q);
