"""The duels in SfePy: hexahedra of degree 1 or 2, Taylor-Hood near nu = 1/2, MKL's Pardiso."""

from __future__ import annotations

from typing import Any

import numpy as np
from scenes import Condition, Duel, main
from sfepy.base.base import IndexedStruct, output
from sfepy.discrete import Equation, Equations, FieldVariable, Function, Integral, Material, Problem
from sfepy.discrete.conditions import Conditions, EssentialBC
from sfepy.discrete.fem import FEDomain, Field, Mesh
from sfepy.solvers.ls import PyPardisoSolver
from sfepy.solvers.nls import Newton
from sfepy.solvers.ts_solvers import SimpleTimeSteppingSolver
from sfepy.terms import Term

output.set_output(quiet=True)
#: Lamé constants of this ratio and more are solved for with a pressure.
MIXED = 1000.0
#: Growth of the residual that its line search accepts: all, as its default takes more iterations.
NO_LINE_SEARCH = 1e12
#: Stiffness of contact per area over E / h.
PENALTY = 10.0


def solve(scene: Duel, degree: int, cells: int) -> dict[str, Any]:
    """Return nodes, displacements, forces and counts."""
    x, connectivity = scene.mesh(cells)
    group = np.zeros(len(connectivity), dtype=np.int32)
    mesh = Mesh.from_data("body", x, None, [connectivity], [group], ["3_8"])
    domain = FEDomain("domain", mesh)
    omega = domain.create_region("Omega", "all")
    choose = {f"at_{i}": c.nodes for i, c in enumerate(scene.conditions)} | {"loaded": scene.loaded}
    if scene.plane or len(scene.parts) > 1:
        choose["touching"] = scene.touching
    functions = {key: lambda x, domain=None, f=f: np.flatnonzero(f(x)) for key, f in choose.items()}

    def kind(chosen: int) -> str:
        """Return the kind of a region: a few corners, faces or all cells."""
        return "vertex" if chosen < 5 else "cell" if chosen == len(x) else "facet"

    regions = {
        key: domain.create_region(
            key, f"vertices by {key}", kind(len(f(x))),
            functions={key: Function(key, f)}, allow_empty=True,
        )
        for key, f in functions.items()
    }  # fmt: skip
    field = Field.from_args("fu", np.float64, "vector", omega, approx_order=degree)
    u, v = (
        FieldVariable("u", "unknown", field),
        FieldVariable("v", "test", field, primary_var_name="u"),
    )
    bulk, mu, one = scene.lam + scene.mu, scene.mu, np.array([[1.0], [1], [1], [0], [0], [0]])
    m = Material("m", bulk=bulk, mu=mu, minus_mu=-mu, compliance=1 / bulk, prestress=mu * one)

    def at_load(ts: Any, coors: Any, mode: Any = None, **_: Any) -> Any:
        if mode == "qp":
            vectors = {"body": scene.body_force, "traction": scene.traction}
            shape = (len(coors), 1, 1)
            return {k: np.tile(ts.time * np.reshape(f, (3, 1)), shape) for k, f in vectors.items()}

    f, integral = Material("f", function=Function("f", at_load)), Integral("i", order=2 * degree)

    def term(text: str, region: Any = omega, **more: Any) -> Any:
        return Term.new(text, integral, region, m=m, f=f, u=u, v=v, **more)

    equations = []
    if scene.lam > MIXED * mu:  # its documented form near nu = 1/2, of the isochoric energy
        scalar = Field.from_args("fp", np.float64, "scalar", omega, approx_order=degree - 1)
        p = FieldVariable("p", "unknown", scalar)
        q = FieldVariable("q", "test", scalar, primary_var_name="p")
        terms = [term("dw_tl_he_neohook(m.mu, v, u)"), term("dw_tl_bulk_pressure(v, u, p)", p=p)]
        volume = term("dw_tl_volume(q, u)", q=q, term_mode="volume") - term("dw_integrate(q)", q=q)
        equations.append(Equation("volume", volume + term("dw_dot(m.compliance, q, p)", q=q, p=p)))
    else:  # mu/2 (I_C - 3) is quadratic in grad u: a Laplacian and a constant stress
        texts = ["dw_div_grad(m.mu, v, u)", "dw_lin_prestress(m.prestress, v)"]
        texts += ["dw_tl_bulk_active(m.minus_mu, v, u)", "dw_tl_bulk_penalty(m.bulk, v, u)"]
        terms = [term(text) for text in texts]
    if scene.plane:
        z = x[:, 2].min() + scene.plane
        corners = [[i, j, z] for i, j in ((-99, -99), (99, -99), (99, 99), (-99, 99))]
        plane = {".n": [0.0, 0, -1], ".a": [0.0, 0, z], ".bs": corners}
        c = Material("c", values=plane | {"f": [PENALTY * scene.E / scene.plane, 0.0]})
        terms.append(term("dw_contact_plane(c.f, c.n, c.a, c.bs, v, u)", regions["touching"], c=c))
    elif len(scene.parts) > 1:
        c = Material("c", values={".epss": PENALTY * scene.E * cells})
        terms.append(term("dw_contact(c.epss, v, u)", regions["touching"], c=c))
    balance = sum(terms[1:], terms[0]) - term("dw_volume_lvf(f.body, v)")
    if any(scene.traction):
        balance = balance - term("dw_surface_ltr(f.traction, v)", regions["loaded"])

    def value(c: Condition) -> Function:
        return Function(f"value_{c.component}", lambda ts, coors, **_: c.value(coors, ts.time))

    problem = Problem("duel", equations=Equations([Equation("balance", balance), *equations]))
    conditions = [
        EssentialBC(f"c{i}", regions[f"at_{i}"], {f"u.{c.component}": value(c)})
        for i, c in enumerate(scene.conditions)
    ]
    problem.set_bcs(ebcs=Conditions(conditions))
    problem.set_ics(Conditions([]))
    counts: list[int] = []

    class Counted(Newton):
        """Newton's method that adds its iterations, and stops a run at a failure."""

        def __call__(self, *arguments: Any, **keywords: Any) -> Any:
            status = IndexedStruct()
            found = super().__call__(*arguments, **{**keywords, "status": status})
            counts.append(status.n_iter)
            if status.condition:
                raise RuntimeError(
                    f"Newton: condition {status.condition} after {counts[-1]} iterations"
                )
            return found

    scale = scene.E * np.prod(np.ptp(x, axis=0)) ** (2 / 3)
    options = {"i_max": 100, "eps_a": 1e-8 * scale, "ls_on": NO_LINE_SEARCH}
    newton = Counted(options, lin_solver=PyPardisoSolver({}))
    times = {"t0": 0.0, "t1": 1.0, "n_step": scene.steps + 1}
    problem.set_solver(SimpleTimeSteppingSolver(times, nls=newton, context=problem))
    state = scene.start(field.get_coor()).ravel() if scene.scatter else None
    variables = problem.solve(state0=state, save_results=False)
    solution = variables()
    problem.remove_bcs()
    forces = problem.get_evaluator().eval_residual(solution.copy(), is_full=True)
    u, f = (variables.get_state_parts(vector)["u"] for vector in (solution, forces))
    return {"x": field.get_coor(), "u": u, "f": f, "newton": sum(counts), "status": "converged"}


if __name__ == "__main__":
    main(solve)
