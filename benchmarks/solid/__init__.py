"""What scenes that follow one another cost the level ``solid``."""
