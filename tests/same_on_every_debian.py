"""What runs on one Debian only: `conftest.py` leaves it out with --other-debian."""

from __future__ import annotations

#: Their tests use neither dolfinx nor PETSc, or repeat what other files test of them.
SAME_ON_EVERY_DEBIAN = frozenset(
    f"test_{name}"
    for name in (
        "arrows",
        "bench",
        "bench_elements",
        "bone_motions",
        "cli_values",
        "constants",
        "demos",
        "docs",
        "docs_commands",
        "eigen3",
        "eigensystem",
        "energy_families",
        "extremes",
        "extremes_obstacles",
        "faults",
        "fit_responses",
        "friction",
        "generated_energies",
        "hertz",
        "impact",
        "integrators",
        "locking",
        "materials",
        "motion_nonlinear",
        "motion_with_friction",
        "movies",
        "names",
        "native_constants",
        "obstacle_motions",
        "obstacle_shapes",
        "obstacle_work",
        "own_material_mistakes",
        "own_references",
        "plots",
        "pointwise_extremes",
        "pointwise_oracle",
        "published_energies",
        "readme",
        "references",
        "reports",
        "round_faces",
        "rubber",
        "scene_mistakes",
        "scene_moves",
        "scene_obstacles",
        "scene_parameters",
        "scene_schema",
        "scene_tables",
        "slurm",
        "smith_materials",
        "smith_properties",
        "stable_neo_hookean",
        "stress_curves",
        "svd",
        "sweep",
        "theory",
        "tuning",
        "unions",
        "view",
        "warm_start",
    )
)

#: Tests that run on one Debian only, of files whose other tests run on every one.
SAME_TESTS = frozenset(
    f"test_{name}"
    for name in (
        # levels and their stopping criteria; the test of the true error has meshes of all kinds
        "accuracy::test_a_body_back_at_rest_has_no_relative_errors",
        "accuracy::test_a_force_without_contact_is_not_within_the_request",
        "accuracy::test_a_jump_on_the_path_of_a_level_is_noted_on_the_last",
        "accuracy::test_bounds_hold_at_a_corner_of_a_nearly_incompressible_body",
        "accuracy::test_levels_follow_the_multipliers_of_contact_again",
        "accuracy::test_the_load_steps_are_followed_on_the_last_mesh",
        "accuracy::test_the_penalty_of_a_fluid_is_raised",
        # sums of estimates, which test_error_estimate makes
        "algebra_error::test_the_parts_of_a_loose_solve_are_those_of_a_tight_one",
        "frequency_errors::test_errors_about_a_loaded_state",
        "path_errors::test_corrected_force_does_not_depend_on_the_mesh_nor_on_its_penalty",
        "path_errors::test_levels_follow_the_path_again_with_stiffer_penalties",
        "path_errors::test_the_error_of_the_load_steps",
        "plane_errors::test_quadrilaterals_have_the_errors_of_the_layer_of_hexahedra",
        "plane_errors::test_the_true_error_is_within_the_request",
        "shape_errors::test_a_finer_mesh_confirms_the_angle_of_bones_that_touch",
        "shape_errors::test_levels_reach_the_accuracy",
        "term_goals::test_effectivity_of_the_force_between_bodies",
        "time_errors::test_a_motion_to_a_required_accuracy",
        "time_errors::test_steps_without_an_order_have_a_bound_and_no_error_of_zero",
        "time_errors::test_the_penalty_of_an_impact",
        # orders of convergence and locking, which follow from element matrices and quadrature:
        # affine patches, exact states, modes and dolfinx's integrals are compared on every Debian
        "element_modes::test_one_degree_less_has_spurious_modes",
        "elements::test_errors_fall_with_the_orders_of_theory",
        "elements::test_who_locks",
        # larger bodies and whole curves, of scenes and features that run everywhere
        "contact_scene::test_thin_plates_collide",
        "curved_cells::test_a_curved_elbow_has_the_flesh_of_finer_cells",
        "elbow::test_accuracy_begins_with_cells_that_the_arm_accepts",
        "elbow::test_stvk_needs_more_iterations_and_loses_volume",
        "plane_contact::test_ring_that_closes_is_the_body",
        "pull::test_nonlinearity_shows_in_large_strain_only",
        # one material of many whose constants are found by scipy
        "fit::test_van_der_waals_is_found",
        # files in an archive
        "install::test_sdist_holds_the_repository",
        "install::test_wheel_holds_every_source",
        # pip installs the same ipctk everywhere; test_ipc has each element
        "ipc_time::test_collision_in_time",
        "ipc_time::test_errors_on_a_path_do_not_include_the_gap",
        "ipc_time::test_friction_in_time",
        # pip installs the same PyVista everywhere
        "hidden_groups::test_the_mark_is_in_the_picture",
        "render::test_a_revolved_section_is_three_quarters_of_the_body",
        "render::test_a_section_has_the_colours_of_the_bar",
        "render::test_an_error_is_drawn_where_it_is_known",
        "render::test_render_bad_files",
        "render::test_render_other_fields_and_chosen_loads",
        "render::test_two_dimensions_are_drawn_in_their_plane",
        "render_fields::test_a_picture_of_a_component",
        "render_obstacles::test_a_picture_and_a_missing_surface",
        # solved as the other tests of derivatives are
        "inverse::test_derivatives_with_a_pressure_and_an_obstacle",
        # what notes say about states, which tests of solvers compute
        "notes::test_a_sweep_has_the_kinds_of_notes",
        "notes::test_an_arch_snaps_through",
    )
)

#: Parameters of tests that select code of dolfinx, FFCx, PETSc, sympy or the compiler: each of
#: their values runs on every Debian, and every combination of them on one. Other parameters are
#: numbers, files with mistakes and messages: their first values run on every Debian.
LIBRARY_PARAMETERS = frozenset(
    (
        "case",
        "cell",
        "degree",
        "element",
        "field",
        "filter",
        "globalization",
        "hessian",
        "integrator",
        "kind",
        "kinematics",
        "m",
        "mass",
        "material",
        "method",
        "name",
        "scene",
        "shape",
        "solver",
        "space",
        "volume",
    )
)
