"""Assets under other light: stills, turntables, videos."""
