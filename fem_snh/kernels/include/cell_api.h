/* The C interface of the cell loops. The C compiler and cffi read this one file; Python fills the structs by
 * field name. All node numbers are local to the rank; displacements have COMPONENTS per node (kinematics.h),
 * 3 in a solid. */

/* The cells that this rank owns, on one element. The sizes NODES, GEOMETRY_NODES, PRESSURE_NODES (per cell)
 * and POINTS (quadrature points per cell) are macros that the code generator defines. */
typedef struct {
  int cells;                        /* number of cells */
  const int *number;                /* [cells] the number of each cell in the matrix and in results */
  const int *nodes;                 /* [cells][NODES] displacement nodes */
  const int *geometry;              /* [cells][GEOMETRY_NODES] geometry nodes */
  const double *x;                  /* [.][3] reference coordinates of the geometry nodes [m] */
  const double *gradients;          /* [POINTS][NODES][3] d(basis)/d(reference cell coordinates); see third_tangent */
  const double *geometry_gradients; /* [POINTS][GEOMETRY_NODES][3] the same for the geometry's basis */
  const double *weights;            /* [POINTS] quadrature weights on the reference cell */
  const double *fractions;          /* [cells] factor of each cell's weights; NULL: 1 */
  const double *constants;          /* the material's constants */
  const int *pressure_nodes;        /* [cells][PRESSURE_NODES]; only if the pressure is an unknown */
  const double *pressure_basis;     /* [POINTS][PRESSURE_NODES] values of the pressure's basis */
  const double *pressure_origin;    /* [pressure nodes] the w of volume_pressure.h; not read if pressure_damping is 0 */
  double pressure_damping;         /* the s of volume_pressure.h: viscous over elastic stiffness of the volume */
} Cells;

/* Where element matrices are added: the value arrays of an AIJ matrix's diagonal block (0) and off-diagonal
 * block (1), and the array of rows owned by other ranks (2). Of a symmetric matrix that stores one half of its diagonal
 * block (block_matrix_api.h), 0 is the half above the block diagonal and 3 the block diagonal; the arrays 0, 1 and 3
 * are then split (split_double.h). */
typedef struct {
  double *values[4];
  float *high[4];         /* the halves of split values, which are those of the matrix times `scale`; NULL: `values` */
  int *rest[4];
  double scale;
  const int *stride[4];   /* [nodes] values per scalar row of a node in each array */
  const int *position;    /* [cells][n][n], n = NODES + PRESSURE_NODES: 4 * (offset of the node pair's first
                             value) + (index of the array); negative for a pair of which only the other half is stored */
  const double *free;     /* [nodes][COMPONENTS] 0 where the displacement is prescribed, else 1 */
  const unsigned char *constrained; /* [cells] 1 if a displacement component of the cell is prescribed */
  const double *rotation; /* [cells][3][3] R: jacobian_cells adds R K_ab R^T instead of the block K_ab; NULL: K_ab */
} MatrixTarget;

/* Return the energy [J] of the cells; +inf if it is infinite at any point. u[nodes][COMPONENTS] are displacements [m];
 * `pressure` [pressure nodes] is NULL unless the pressure is an unknown. */
double energy_cells(const Cells *c, const double *u, const double *pressure);

/* r += dE/du [N] and r_p += dE/dp, at owned and ghost nodes. */
void residual_cells(const Cells *c, const double *u, const double *pressure, double *r, double *r_p);

/* Add the filtered Jacobian to `t`. `filter` and `solver` are positions in fem_snh.choices.POINT_FILTERS and
 * EIGENSOLVERS. Returns the number of quadrature points where the exact material Hessian has a negative eigenvalue. */
long jacobian_cells(const Cells *c, const double *u, const double *pressure, int filter, int solver,
                    const MatrixTarget *t);

/* fields[cells][5]: volume and deformed volume [m^3], smallest J, energy [J], smallest eigenvalue of the
 * exact material Hessian [Pa]. */
void fields_cells(const Cells *c, const double *u, const double *pressure, double *fields);
