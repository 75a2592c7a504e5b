"""What a run writes: fields, projections to nodes, series of files, tables."""
