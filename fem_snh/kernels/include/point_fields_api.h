/* Output fields at points. The C compiler and cffi read this one file. */

/* The arrays to which fields are written, point by point; NULL for a field that is not wanted. Tensors are [9] by rows. */
typedef struct {
  double *cauchy_stress;         /* [n][9] P F^T / J [Pa]; NaN where J = 0 */
  double *von_mises;             /* [n] sqrt(3/2 s : s) [Pa], s the deviator of the Cauchy stress */
  double *principal_stresses;    /* [n][3] eigenvalues of the Cauchy stress [Pa], descending */
  double *hydrostatic_stress;    /* [n] a third of the Cauchy stress's trace [Pa] */
  double *pk1_stress;            /* [n][9] P [Pa] */
  double *green_lagrange_strain; /* [n][9] (H + H^T + H^T H) / 2: accurate also where it is small */
  double *principal_stretches;   /* [n][3] signed singular values of F, descending */
} PointFields;

/* Write the fields at n points from H = F - I [9][n] and P [9][n], whose 9 components are stored by columns. */
void point_fields(long n, const double *H, const double *P, const PointFields *out);
