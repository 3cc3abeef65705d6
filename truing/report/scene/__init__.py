"""3-D view: places, amplified displacements and legs, step by step."""
