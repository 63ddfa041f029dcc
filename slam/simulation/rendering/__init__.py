"""How the simulated town becomes images: rasterizer, shading, and the model of the sensor."""
