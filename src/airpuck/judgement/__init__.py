"""What recordings say: one model, its findings, and whether to trust it. Entry point: `study`."""
