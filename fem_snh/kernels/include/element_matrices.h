/* Geometry, deformation gradient and element stiffness at the quadrature points of W cells, and the addition
 * of element matrices to the global one. The structs Cells and MatrixTarget are in cell_api.h. */

enum { ALL_NODES = NODES + PRESSURE_NODES };

/* W cells and the next one; cells past the last repeat it. */
INLINE void next_cells(const Cells *c, long start, long *cell) {
  for (int l = 0; l <= W; ++l) cell[l] = start + l < c->cells ? start + l : c->cells - 1;
}

/* The factors of the quadrature weights of W cells. */
INLINE real cell_fractions(const Cells *c, const long *cell) {
  real fraction = splat(1);
  if (c->fractions)
    for (int l = 0; l < W; ++l) fraction[l] = c->fractions[cell[l]];
  return fraction;
}

/* The inverse I of the map's derivative at quadrature point q, I[3 k + i] = dxi_k/dx_i; `weight` is the quadrature weight
 * times |det dx/dxi| and the cell's fraction. */
INLINE void geometry_point(const Cells *c, const real x[GEOMETRY_NODES][3], real fraction, int q, real *I, real *weight) {
  const double *dx = c->geometry_gradients + 3 * GEOMETRY_NODES * q;
  real T[9]; /* T[3 k + i] = dx_i/dxi_k; its cofactors are det T times I */
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i) {
      real sum = splat(0);
      for (int a = 0; a < GEOMETRY_NODES; ++a) sum += x[a][i] * dx[3 * a + k];
      T[3 * k + i] = sum;
    }
  third_tangent(T);
  cross(T + 3, T + 6, I);
  cross(T + 6, T, I + 3);
  cross(T, T + 3, I + 6);
  const real det = dot(T, I), inverse = 1 / det;
  for (int i = 0; i < 9; ++i) I[i] *= inverse;
  *weight = absolute(det) * fraction * c->weights[q];
}

/* The product Y = X I^T of 3x3 matrices X, Y stored by columns: Y[3 k + i] = sum_j X[3 j + i] I[3 k + j]. For a derivative X
 * by F the derivative by the nodal displacement u_a is sum_k Y[3 k + i] dN_a/dxi_k. */
INLINE void to_reference(const real *X, const real *I, real *Y) {
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i) Y[3 * k + i] = X[i] * I[3 * k] + X[3 + i] * I[3 * k + 1] + X[6 + i] * I[3 * k + 2];
}

/* Row i of a matrix X by columns times a node's derivatives d[3] on the reference cell. */
INLINE real along(const real *X, const double *d, int i) { return X[i] * d[0] + X[3 + i] * d[1] + X[6 + i] * d[2]; }

/* H = grad u and F = I + H. Both are needed: F has lost the digits of a small H (see small_strain.h). */
INLINE void deformation_point(const Cells *c, int q, const real *I, const real u[NODES][3], real *F, real *H) {
  const double *d = c->gradients + 3 * NODES * q;
  real A[9]; /* A[3 k + i] = du_i/dxi_k */
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i) {
      real sum = splat(0);
      for (int a = 0; a < NODES; ++a) sum += u[a][i] * d[3 * a + k];
      A[3 * k + i] = sum;
    }
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) H[3 * j + i] = A[i] * I[j] + A[3 + i] * I[3 + j] + A[6 + i] * I[6 + j];
  third_column(H);
  for (int i = 0; i < 9; ++i) F[i] = H[i] + (i % 4 == 0);
}

/* Returns J = det F; cofactor = cof F = dJ/dF by columns (Smith et al. 2018, eq. 19). */
INLINE real determinant(const real *F, real *cofactor) {
  cross(F + 3, F + 6, cofactor);
  cross(F + 6, F, cofactor + 3);
  cross(F, F + 3, cofactor + 6);
  return dot(F, cofactor);
}

/* Load nodal values of W cells into lanes. */
#define GATHER(lanes, count, size, map, values) \
  for (int l = 0; l < W; ++l)                   \
    for (int a = 0; a < (count); ++a)           \
      for (int i = 0; i < (size); ++i) lanes[a][i][l] = (values)[(size) * (long)(map)[(count) * cell[l] + a] + i];

enum { PAIRS = NODES * (NODES + 1) / 2 };

/* The gradients G[NODES][3] of the basis in the coordinates x at quadrature point q. */
INLINE void basis_gradients(const Cells *c, int q, const real *I, real *G) {
  const double *d = c->gradients + 3 * NODES * q;
  for (int a = 0; a < NODES; ++a)
    for (int i = 0; i < 3; ++i) G[3 * a + i] = along(I, d + 3 * a, i);
}

/* K += weight * G^T C G: the 3x3 blocks (a, b) with a <= b, ordered by b, then a, each row-major. Only the leading
 * COMPONENTS rows and columns of a block are set. */
INLINE void add_stiffness(const real *C, const real *G, real weight, real *K) {
  real *block = K;
  for (int b = 0; b < NODES; ++b) {
    real T[27]; /* T[9 k + 3 i + j] = sum_l C[(i,k),(j,l)] G_bl */
    const real g0 = G[3 * b] * weight, g1 = G[3 * b + 1] * weight THIRD(, g2 = G[3 * b + 2] * weight);
    for (int k = 0; k < DERIVATIVES; ++k)
      for (int i = 0; i < COMPONENTS; ++i)
        for (int j = 0; j < COMPONENTS; ++j) {
          const real *row = C + 9 * (3 * k + i) + j;
          T[9 * k + 3 * i + j] = row[0] * g0 + row[3] * g1 THIRD(+ row[6] * g2);
        }
    for (int a = 0; a <= b; ++a, block += 9)
      for (int i = 0; i < COMPONENTS; ++i)
        for (int j = 0; j < COMPONENTS; ++j) {
          const int m = 3 * i + j;
          block[m] += G[3 * a] * T[m] + G[3 * a + 1] * T[9 + m] THIRD(+ G[3 * a + 2] * T[18 + m]);
        }
  }
}

/* Replace each 3x3 block B of the element matrices K of W cells by R B R^T with the cell's rotation R. */
INLINE void rotate_blocks(const Cells *c, const double *rotation, const long *cell, real *K) {
  real R[9], T[9];
  for (int i = 0; i < 9; ++i)
    for (int l = 0; l < W; ++l) R[i][l] = rotation[9 * (long)c->number[cell[l]] + i];
  for (real *block = K; block < K + 9 * PAIRS; block += 9) {
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) T[3 * i + j] = dot(block + 3 * i, R + 3 * j);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) block[3 * i + j] = R[3 * i] * T[j] + R[3 * i + 1] * T[3 + j] + R[3 * i + 2] * T[6 + j];
  }
}

/* MatrixTarget's positions of the blocks of a cell. */
INLINE const int *positions(const Cells *c, const MatrixTarget *t, long cell) {
  return t->position + (long)ALL_NODES * ALL_NODES * c->number[cell];
}

/* Add the element matrix of lane l to the global matrix: each block (a, b) and, transposed, (b, a). Memory is slower
 * than the additions, so the same blocks of the next cell are prefetched. */
INLINE void scatter(const Cells *c, const MatrixTarget *t, const long *cell, const real *K, int l) {
  const int *nodes = c->nodes + NODES * cell[l], *next_nodes = c->nodes + NODES * cell[l + 1];
  const int *position = positions(c, t, cell[l]), *next = positions(c, t, cell[l + 1]);
  const double *block = (const double *)K + l;
  for (int b = 0; b < NODES; ++b)
    for (int a = 0; a <= b; ++a, block += 9 * W) {
      prefetch_block(t, next_nodes[a], next[ALL_NODES * a + b], COMPONENTS);
      prefetch_block(t, next_nodes[b], next[ALL_NODES * b + a], COMPONENTS);
      add_block(t, nodes[a], position[ALL_NODES * a + b], COMPONENTS, block, 3 * W, W);
      if (a != b) add_block(t, nodes[b], position[ALL_NODES * b + a], COMPONENTS, block, W, 3 * W);
    }
}
