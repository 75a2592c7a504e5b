"""Words of other programs for the tables and keys of a scene, which messages translate.

They are those of Abaqus, Ansys, code_aster, COMSOL, FEBio, FEniCS tutorials and SOFA, in lower case
with underscores.
"""

from __future__ import annotations

from collections.abc import Iterable

#: For the names of this program, the words that others use. A name in brackets is a table of the
#: scene, one with an equals sign what to write there; any other is a key, of whichever table has
#: it. Of several names the keys come first.
_WORDS: dict[tuple[str, ...], str] = {
    ("translate", "[[move]]", "[[hold]]"): (
        "displacement displacements displ disp u ux uy uz dx dy dz ddl_impo char_meca prescribed "
        "prescribed_displacement prescribed_displacements imposed imposed_displacement dirichlet "
        "dirichletbc dirichlet_bc bc bcs boundary boundary_condition boundary_conditions motion "
        "value vector"
    ),
    ("[[hold]]",): (
        "fix fixed fixed_displacement fixed_support fixedconstraint fixed_constraint encastre "
        "clamp clamped support supports constrain constraint constraints face_impo spc pinned "
        "zero_displacement"
    ),
    ("components",): "axes axis dof dofs direction directions degrees_of_freedom fixed_directions",
    ("vector", "[[traction]]"): (
        "force forces force_face force_surfacique load loads surface_load surface_force cload "
        "value dload dsload traction tractions neumann neumann_bc t surface_traction "
        "constant_force_field"
    ),
    ("value", "[[pressure]]"): (
        "pressure pressures pres pres_rep follower follower_load follower_pressure inflation "
        "magnitude vector p surface_pressure surface_pressure_force_field"
    ),
    ("vector", "[gravity]"): (
        "gravity g body_force body_load body_forces weight pesanteur gravitation acceleration "
        "volume_force force_interne"
    ),
    ("stiffness", "[[spring]]"): (
        "k spring springs elastic_foundation foundation robin winkler rest_shape_springs"
    ),
    ("[[contact]]",): (
        "contact contacts contact_pair contact_pairs sliding tied sliding_elastic "
        "interaction interactions surface_interaction"
    ),
    ("[[obstacle]]",): (
        "obstacle obstacles rigid rigid_wall rigid_body rigid_bodies rigid_surface indenter plate "
        "floor ground wall"
    ),
    ("[self_contact]",): "self_contact selfcontact self_collision collision collisions",
    ("[[bone]]",): "bone bones skeleton",
    ("[[cavity]]",): "cavity fluid_cavity fluid volume_constraint",
    ("table", "[[table]]"): (
        "table amplitude amplitudes function load_curve loadcurve lc curve time_function "
        "load_controller fonction ramp"
    ),
    ("points",): "data values xy",
    ("[time]",): "time dynamic dynamics transient time_integration newmark animation",
    ("[start]",): (
        "initial initial_condition initial_conditions initial_velocity initial_displacement v0"
    ),
    ("[modes]",): "mode frequency frequencies eigenvalues eigenfrequencies modal buckle",
    ("[material]",): (
        "barrier alpha alpha_mu alpha_lambda lambda_part epsilon exponents weights c1 c2 density "
        "materials mat mats elasticity hyperelastic hyperelasticity hyperelasticmaterial "
        "constitutive constitutive_law constitutive_model material_law defi_materiau affe_materiau"
    ),
    ("name",): "type model law energy material_name",
    ("E", "[material]"): (
        "e young youngs youngs_modulus young_modulus elastic_modulus modulus young_s_modulus"
    ),
    ("nu", "[material]"): "v poisson poissons_ratio poisson_ratio poissonratio",
    ("E", "nu", "[material]"): "mu lambda lambda_ lam lame shear_modulus bulk_modulus kappa c10 d1",
    ("density", "[material]"): "rho mass_density masse_volumique",
    ("mesh", "mesh = 'FILE'"): (
        "path filename geometry grid domain mesh_file meshfile file msh model_file maillage part"
    ),
    ("group",): (
        "surface surfaces boundary face faces nset node_set nodeset elset element_set elem_set "
        "set region regions where on tag tags marker markers subdomain group_ma group_no "
        "physical_group groupe entity patch part id selection"
    ),
    ("element",): "elements element_type elem_type eltype fe finite_element formulation",
    ("cells",): "n num_cells resolution divisions subdivisions mesh_size",
    ("steps",): (
        "increments increment nsteps n_steps num_steps time_steps load_steps loadsteps dt time_step"
    ),
    ("fields",): "field output outputs plotfile field_output element_data resultats var variables",
    ("reactions",): "reaction reaction_force reaction_forces history_output",
    ("[[probe]]",): "probes sensor sensors monitor monitors node_output measure",
    ("petsc",): "solver control controls options solver_options petsc_options solver_parameters",
    ("center",): "centre origin",
    ("radius",): "r diameter",
    ("angle",): "theta degrees rotation_angle",
    ("rotate",): "rotation turn twist",
    ("translate",): "translation offset shift",
    ("friction",): "mu_friction fric_coeff friction_coefficient coulomb",
    ("duration", "[time]"): "duration end tend t_end end_time final_time",
    ("integrator",): "scheme method solver_type",
}

#: What this program does not have, with the next thing that it has, and the words for it.
_ABSENT: dict[str, str] = {
    "there is no viscoelasticity: 'damping' of [time] has the viscosity of Kelvin and Voigt": (
        "viscoelastic viscoelasticity visco viscosity prony maxwell relaxation creep"
    ),
    "there is no swelling or thermal expansion: in a program an energy in UFL may have it": (
        "swelling swell growth thermal thermal_expansion expansion temperature cte shrinkage "
        "eigenstrain"
    ),
    "there are solids alone: a thin body is 'Q2' or 'P2' cells, kinematics = 'axisymmetric' or "
    "'plane_stress', whose forces are per thickness": (
        "membrane membranes shell shells beam beams truss trusses plate_element thickness"
    ),
    "there are elastic energies alone: no plasticity, damage or Mullins effect": (
        "plastic plasticity yield_stress hardening damage mullins fracture hysteresis"
    ),
    "there are no fibres and no active stress: in a program an energy in UFL may have them": (
        "fibre fibres fiber fibers anisotropy anisotropic active active_stress activation "
        "contraction"
    ),
    "there are no periodic or tied surfaces: one mesh with common nodes, or [[contact]]": (
        "periodic periodicity tie mpc multipoint_constraint"
    ),
    "there are no stages: loads and motions have a 'table' each, and [start] run = 'DIR' begins "
    "with the state of another run": "stage stages phase phases load_case load_cases",
}


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for a word of another program, or ``""``.

    Of what this program does not have it says so, and what it has.

    Parameters
    ----------
    word : str
        An unknown key.
    known : iterable of str
        The keys of its table.
    """
    plain = word.strip().lower().replace("-", "_").replace(" ", "_")
    known = list(known)
    found: list[str] = []
    tables: list[str] = []
    for names, words in _WORDS.items():
        if plain in words.split():
            found += [f"'{name}'" for name in names if name in known]
            tables += [name for name in names if name.startswith("[") or "=" in name]
    chosen = list(dict.fromkeys(found or tables))
    for text, words in _ABSENT.items():
        if not chosen and plain in words.split():
            return f" ({text})"
    return f" (did you mean {' or '.join(chosen)}?)" if chosen else ""
