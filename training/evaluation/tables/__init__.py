"""What is shown of the measurements: tables, sheets, documents."""
