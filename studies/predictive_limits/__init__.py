"""Parts of the study of the predictive law."""
