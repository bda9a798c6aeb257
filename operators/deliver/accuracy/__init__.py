"""Error against run time: what is measured of the open scene, and the page that helps to choose."""
