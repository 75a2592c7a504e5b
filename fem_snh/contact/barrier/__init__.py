"""Self-contact by the barrier of incremental potential contact (Li et al. 2020)."""
