/* Contact at the quadrature points of a surface's facets. The C compiler and cffi read this one file.
 *
 * Arguments `m, which` choose facets: which [m], or NULL for the first m. Arrays of chosen facets have a row for each,
 * other arrays a row for each facet of the surface. Nodal displacements u [nodes][3] are padded in two dimensions. */

typedef struct {
  int points, nodes;     /* quadrature points and nodes of a facet */
  int components;        /* components of a displacement, 2 or 3 */
  int cell_nodes;        /* nodes of a cell */
  const int *node;       /* [facets][nodes] local nodes */
  const int *cell_node;  /* [facets][nodes] their indices among the nodes of the facet's cell */
  const double *basis;   /* [points][nodes] shape functions */
  const double *X;       /* [facets][points][3] reference coordinates [m] */
  const double *weight;  /* [facets][points] quadrature weights [m^2] */
} Facets;

/* The largest squared distance [m^2] from R^T (X + u - c) to `before` [n][3], of nodes [n] with coordinates X [n][3]. */
double largest_move(long n, const int *node, const double *X, const double *u, const double *R, const double *c,
                    const double *before);

/* Whether two arrays of n numbers have the same bits. */
int same_values(long n, const double *a, const double *b);

/* y [m][points][3] = sum_a N_a u_a, plus X if `deformed` */
void facet_vectors(const Facets *f, int m, const int *which, const double *u, int deformed, double *y);

/* out [nodes][components] += sum_q N_a v_q from v [m][points][size], size >= components */
void add_facet_vectors(const Facets *f, int m, const int *which, const double *v, int size, int components, double *out);

/* The response of n rows of `size` points with stiffness k [Pa/m], multipliers l [Pa], both [rows of all][size], and
 * gaps g [n][size] [m], per reference area: energy [J/m^2], pressure p = <l - k g> [Pa], and minus its derivative by g.
 * With gaps g0 at the start of a step, else NULL, it is the mean of a penalty over the step
 * (fem_snh.contact.facet_loops.response), without multipliers. `row` [n] may be NULL: the first n. */
void contact_response(int n, int size, const int *row, const double *k, const double *l, const double *g0, const double *g,
                      double *energy, double *pressure, double *stiffness);

/* Normal contact and friction of chosen facets: [m][points] and more. */
typedef struct {
  const double *pressure;  /* [Pa] */
  const double *stiffness; /* minus the derivative of the pressure by the gap [Pa/m] */
  const double *normal;    /* [3] the gap's gradient */
  const double *curvature; /* [9] the gap's Hessian [1/m] */
} NormalContact;

typedef struct {
  const double *stiffness; /* [facets] tangential stiffness k [Pa/m] */
  const double *normal;    /* [facets][points][3] lagged unit normals */
  const double *limit;     /* [m][points] largest stress [Pa]: the coefficient times the lagged pressure */
  const double *offset;    /* [m][points][3] the slip without the step's displacement [m] */
} Friction;

/* Forces on the body f_q = w_q p n [N], [m][points][3]. */
void contact_forces(const Facets *f, int m, const int *which, const NormalContact *c, double *force);

/* Slips s and stresses t of friction on the obstacle, [m][points][3], from the step's displacement u. Returns the
 * energy. */
double friction_stresses(const Facets *f, int m, const int *which, const Friction *c, const double *u, double *slip,
                         double *stress);

/* The energy's Hessians at points, w (k n n^T - p curvature), with the second term filtered, times `factor`, as
 * matrices of the facets' cells, K [m][n][n] with n = components * cell_nodes, for facets that are in contact: their
 * rows are written to `acting` [m]; returns how many there are. `filtered` counts points whose curvature was
 * indefinite for the filter. */
int contact_matrices(const Facets *f, int m, const int *which, const NormalContact *c, int filter, double factor,
                     int *acting, double *K, int *filtered);

/* The Hessians of friction, for all chosen facets, from the slips [m][points][3]. */
void friction_matrices(const Facets *f, int m, const int *which, const Friction *c, const double *slip, double *K);
