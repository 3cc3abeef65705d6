"""The section of photographs: network, residuals, cameras, rejected rays."""
