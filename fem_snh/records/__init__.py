"""What a run records, for its writer and its readers: files, tables, notes, fields and units."""
