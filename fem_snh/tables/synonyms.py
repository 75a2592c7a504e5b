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


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for a word of another program, or ``""``.

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
    return f" (did you mean {' or '.join(chosen)}?)" if chosen else ""
