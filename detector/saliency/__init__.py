"""The paper's saliency: normals, robust PCA, eigenvalues."""
