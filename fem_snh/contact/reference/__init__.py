"""Self-contact through the reference configuration (Smith et al. 2018, section 6)."""
