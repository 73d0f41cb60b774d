"""The published method's three networks: canonicalisation, winding-number field, warp field."""
