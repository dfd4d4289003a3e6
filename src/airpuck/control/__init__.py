"""Model -> motor commands."""
