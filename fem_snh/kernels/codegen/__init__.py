"""From a material's expression to C: derivatives, divided differences, small strains, printing."""
