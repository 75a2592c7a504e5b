/* The steps of block_matrix_api.h and coarse_space_api.h for LANES right-hand sides. The C compiler and cffi read this one
 * file. Nodal vectors are [rows][BLOCK][LANES] floats, coarse vectors [columns][LANES], and a sum has one number a lane. */

/* w = (D + L)^-1 w. */
void columns_solve_lower(const SymmetricBlockMatrix *b, float *w);

/* y = (D + L) w. */
void columns_multiply_lower(const SymmetricBlockMatrix *b, const float *w, float *y);

/* p = z + beta p, t = (D + U)^-1 p, w = U t. */
void columns_backward_sweep(const SymmetricBlockMatrix *b, const float *beta, const float *z, float *p, float *t, float *w);

/* q = t + (D + L)^-1 (w - shift t + the other ranks' columns times their t, in `ghosts`); dot = p.q. */
void columns_forward_sweep(const SymmetricBlockMatrix *b, const float *p, const float *t, const float *ghosts, const float *w, float *q, double *dot);

/* x += alpha t, r -= alpha q, z = D r; dot = r.z. */
void columns_update(const SymmetricBlockMatrix *b, const float *alpha, const float *t, const float *q, float *x, float *r, float *z, double *dot);

/* y += (A Z)^T t; r -= A Z y; y += Z^T r; x += Z y. */
void columns_image_transposed(const CoarseSpace *c, const float *t, double *y);
void columns_image_subtract(const CoarseSpace *c, const float *y, float *r);
void columns_restrict(const CoarseSpace *c, const float *r, double *y);
void columns_prolong(const CoarseSpace *c, const float *y, float *x);
