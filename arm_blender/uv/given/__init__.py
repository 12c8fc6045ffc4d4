"""What a user's mesh brings: files as they are found, polygons, UVs that are an atlas or not."""
