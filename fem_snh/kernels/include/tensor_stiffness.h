/* The stiffness of hexahedra of degree TENSOR_NODES - 1 by sum factorisation (Orszag 1980, doi:10.1016/0021-9991(80)90005-4).
 *
 * Basis functions are products N_a = N_a1(xi_1) N_a2(xi_2) N_a3(xi_3) and the quadrature points a grid, so that the sum
 * over the points is taken over one direction after the other. For 27 nodes and 27 points these are 105,000
 * multiplications in place of 295,000, and the 217 kB of W element matrices are written once, not at each point. */
enum { GRID = TENSOR_NODES * TENSOR_NODES, GRID_POINTS = TENSOR_POINTS * TENSOR_POINTS * TENSOR_POINTS };
static const double tensor_basis[2][TENSOR_POINTS][TENSOR_NODES] = {TENSOR_BASIS}; /* values, derivatives */
static const int tensor_node[NODES] = {TENSOR_NODE};    /* the node at each place of the grid */
static const int tensor_point[POINTS] = {TENSOR_POINT}; /* the place of each point in the grid */

/* The stiffness in coordinates of the reference cell. It is 14 MB with the highest quadrature degree, more than a stack
 * may hold: each thread has its own. D[pair (i, k), i <= k][place of the point][3 J + L] =
 * weight sum_jl dxi_J/dx_j C[(i,j),(k,l)] dxi_L/dx_l. */
typedef real TensorStiffness[6][GRID_POINTS][9];
static _Thread_local TensorStiffness tensor_stiffness_of_points;

INLINE void tensor_stiffness_point(const real *C, const real *I, real weight, int q, TensorStiffness D) {
  for (int i = 0, pair = 0; i < 3; ++i)
    for (int k = i; k < 3; ++k, ++pair) {
      real T[9], *d = D[pair][tensor_point[q]]; /* T[3 j + L] = weight sum_l C[(i,j),(k,l)] dxi_L/dx_l */
      for (int j = 0; j < 3; ++j) {
        const real *row = C + 9 * (3 * j + i) + k;
        for (int L = 0; L < 3; ++L) T[3 * j + L] = (row[0] * I[3 * L] + row[3] * I[3 * L + 1] + row[6] * I[3 * L + 2]) * weight;
      }
      for (int J = 0; J < 3; ++J)
        for (int L = 0; L < 3; ++L) d[3 * J + L] = I[3 * J] * T[L] + I[3 * J + 1] * T[3 + L] + I[3 * J + 2] * T[6 + L];
    }
}

/* Whether each of two reference derivatives J, L is along `direction`, as two bits. */
#define ALONG(direction, J, L) (2 * ((J) == (direction)) + ((L) == (direction)))

/* Set K, as add_stiffness does. */
SHARED void tensor_stiffness(const TensorStiffness D, real *K) {
  double S[4][GRID][TENSOR_POINTS]; /* products of the basis of a and of b, by which of them are derivatives */
  for (int e = 0; e < 4; ++e)
    for (int ab = 0; ab < GRID; ++ab)
      for (int q = 0; q < TENSOR_POINTS; ++q)
        S[e][ab][q] = tensor_basis[e / 2][q][ab / TENSOR_NODES] * tensor_basis[e % 2][q][ab % TENSOR_NODES];
  for (int i = 0, pair = 0; i < 3; ++i)
    for (int k = i; k < 3; ++k, ++pair) {
      real Y[GRID][GRID][TENSOR_POINTS][4]; /* summed over directions 3 and 2: [a3 b3][a2 b2][q1][ALONG(0, J, L)] */
      for (int q1 = 0; q1 < TENSOR_POINTS; ++q1) {
        real X[GRID][TENSOR_POINTS][9]; /* summed over direction 3: [a3 b3][q2][3 J + L] */
        for (int q2 = 0; q2 < TENSOR_POINTS; ++q2)
          for (int JL = 0; JL < 9; ++JL) {
            const real(*d)[9] = D[pair] + TENSOR_POINTS * (TENSOR_POINTS * q1 + q2);
            const double(*s)[TENSOR_POINTS] = S[ALONG(2, JL / 3, JL % 3)];
            for (int ab = 0; ab < GRID; ++ab) {
              real sum = splat(0);
              for (int q3 = 0; q3 < TENSOR_POINTS; ++q3) sum += s[ab][q3] * d[q3][JL];
              X[ab][q2][JL] = sum;
            }
          }
        for (int ab3 = 0; ab3 < GRID; ++ab3)
          for (int ab2 = 0; ab2 < GRID; ++ab2) {
            real sum[4] = {splat(0), splat(0), splat(0), splat(0)};
            for (int q2 = 0; q2 < TENSOR_POINTS; ++q2)
              for (int J = 0; J < 3; ++J)
                for (int L = 0; L < 3; ++L)
                  sum[ALONG(0, J, L)] += S[ALONG(1, J, L)][ab2][q2] * X[ab3][q2][3 * J + L];
            for (int e = 0; e < 4; ++e) Y[ab3][ab2][q1][e] = sum[e];
          }
      }
      for (int ab3 = 0; ab3 < GRID; ++ab3)
        for (int ab2 = 0; ab2 < GRID; ++ab2)
          for (int ab1 = 0; ab1 < GRID; ++ab1) {
            const int at[2] = {ab3 / TENSOR_NODES + TENSOR_NODES * (ab2 / TENSOR_NODES + TENSOR_NODES * (ab1 / TENSOR_NODES)),
                               ab3 % TENSOR_NODES + TENSOR_NODES * (ab2 % TENSOR_NODES + TENSOR_NODES * (ab1 % TENSOR_NODES))};
            const int a = tensor_node[at[0]], b = tensor_node[at[1]];
            if (i == k && a > b) continue;
            real sum = splat(0);
            for (int q1 = 0; q1 < TENSOR_POINTS; ++q1)
              for (int e = 0; e < 4; ++e) sum += S[e][ab1][q1] * Y[ab3][ab2][q1][e];
            if (a <= b) K[9 * (b * (b + 1) / 2 + a) + 3 * i + k] = sum;
            if (a >= b) K[9 * (a * (a + 1) / 2 + b) + 3 * k + i] = sum;
          }
    }
}
