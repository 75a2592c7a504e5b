/* Geometry, deformation gradient and element stiffness at the quadrature points of W cells, and the addition
 * of element matrices to the global one. The structs Cells and MatrixTarget are in cell_api.h. */

enum { ALL_NODES = NODES + PRESSURE_NODES };

/* The factors of the quadrature weights of W cells; lanes past the last cell repeat it. */
INLINE real cell_fractions(const Cells *c, long start) {
  real fraction = splat(1);
  if (c->fractions)
    for (int l = 0; l < W; ++l) fraction[l] = c->fractions[start + l < c->cells ? start + l : c->cells - 1];
  return fraction;
}

/* Gradients G[NODES][3] of the basis in reference coordinates at quadrature point q; `weight` is the quadrature
 * weight times |det dx/dxi| and the cell's fraction. */
INLINE void geometry_point(const Cells *c, const real x[GEOMETRY_NODES][3], real fraction, int q, real *G, real *weight) {
  const double *dx = c->geometry_gradients + 3 * GEOMETRY_NODES * q, *d = c->gradients + 3 * NODES * q;
  real T[9], K[9]; /* T[3 k + i] = dx_i/dxi_k; K its cofactors, det T times the inverse transpose */
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i) {
      real sum = splat(0);
      for (int a = 0; a < GEOMETRY_NODES; ++a) sum += x[a][i] * dx[3 * a + k];
      T[3 * k + i] = sum;
    }
  third_tangent(T);
  cross(T + 3, T + 6, K);
  cross(T + 6, T, K + 3);
  cross(T, T + 3, K + 6);
  const real det = dot(T, K), inverse = 1 / det;
  for (int a = 0; a < NODES; ++a)
    for (int i = 0; i < 3; ++i)
      G[3 * a + i] = (K[i] * d[3 * a] + K[3 + i] * d[3 * a + 1] + K[6 + i] * d[3 * a + 2]) * inverse;
  *weight = absolute(det) * fraction * c->weights[q];
}

/* H = grad u and F = I + H. Both are needed: F has lost the digits of a small H (see small_strain.h). */
INLINE void deformation_point(const real *G, const real u[NODES][3], real *F, real *H) {
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) {
      real sum = splat(0);
      for (int a = 0; a < NODES; ++a) sum += u[a][i] * G[3 * a + j];
      H[3 * j + i] = sum;
      F[3 * j + i] = sum + (i == j);
    }
#if KINEMATICS == REVOLVED
  third_column(H);
  for (int i = 0; i < 3; ++i) F[6 + i] = H[6 + i] + (i == 2);
#endif
}

/* Returns J = det F; cofactor = cof F = dJ/dF by columns (Smith et al. 2018, eq. 19). */
INLINE real determinant(const real *F, real *cofactor) {
  cross(F + 3, F + 6, cofactor);
  cross(F + 6, F, cofactor + 3);
  cross(F, F + 3, cofactor + 6);
  return dot(F, cofactor);
}

/* Load nodal values of W cells into lanes; lanes past the last cell repeat it. */
#define GATHER(lanes, count, size, map, values)                            \
  for (int l = 0; l < W; ++l) {                                            \
    const long cell = start + l < c->cells ? start + l : c->cells - 1;     \
    for (int a = 0; a < (count); ++a)                                      \
      for (int i = 0; i < (size); ++i)                                     \
        lanes[a][i][l] = (values)[(size) * (long)(map)[(count) * cell + a] + i]; \
  }

enum { PAIRS = NODES * (NODES + 1) / 2 };

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
INLINE void rotate_blocks(const double *rotation, long start, int lanes, real *K) {
  real R[9], T[9];
  for (int i = 0; i < 9; ++i)
    for (int l = 0; l < W; ++l) R[i][l] = rotation[9 * (start + (l < lanes ? l : lanes - 1)) + i];
  for (real *block = K; block < K + 9 * PAIRS; block += 9) {
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) T[3 * i + j] = dot(block + 3 * i, R + 3 * j);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) block[3 * i + j] = R[3 * i] * T[j] + R[3 * i + 1] * T[3 + j] + R[3 * i + 2] * T[6 + j];
  }
}

/* Add the element matrix of lane l to the global matrix: each block (a, b) and, transposed, (b, a). Memory is slower
 * than the additions, so the same blocks of the next cell are prefetched, unless this cell is the last. */
INLINE void scatter(const MatrixTarget *t, const int *nodes, const int *position, const real *K, int l, int is_last) {
  const int *next_nodes = is_last ? nodes : nodes + NODES, *next = is_last ? position : position + ALL_NODES * ALL_NODES;
  const double *block = (const double *)K + l;
  for (int b = 0; b < NODES; ++b)
    for (int a = 0; a <= b; ++a, block += 9 * W) {
      prefetch_block(t, next_nodes[a], next[ALL_NODES * a + b], COMPONENTS);
      prefetch_block(t, next_nodes[b], next[ALL_NODES * b + a], COMPONENTS);
      add_block(t, nodes[a], position[ALL_NODES * a + b], COMPONENTS, block, 3 * W, W);
      if (a != b) add_block(t, nodes[b], position[ALL_NODES * b + a], COMPONENTS, block, W, 3 * W);
    }
}
