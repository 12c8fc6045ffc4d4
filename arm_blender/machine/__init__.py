"""What any program needs of a computer: memory, threads, files, libraries, downloads."""
