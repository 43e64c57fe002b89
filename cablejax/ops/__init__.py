"""Kernels over point clouds: pure functions of arrays, usable under jit, vmap and grad, on any device.

Neighbours (`knn`, `radius_search`, `radius_count`), local moments, outlier removal and the adaptive filter.
"""

from cablejax.ops.cleaning import CleanResult, clean
from cablejax.ops.cylinder import CylinderFrame, cylinder_frame, principal_frame
from cablejax.ops.edges import (
    AttentionWeights,
    channel_attention,
    edge_conv,
    edge_features,
    neighbor_max,
    neighbor_sum,
)
from cablejax.ops.eigen import SymmetricEigen, symmetric_eigen
from cablejax.ops.feature_graph import feature_graph
from cablejax.ops.filter_width import Trial, choose_alpha, pilot_places, usual_noise, width_trial
from cablejax.ops.filters import FilterResult, adaptive_filter
from cablejax.ops.graph import EdgeList, edge_list, knn_graph, radius_graph
from cablejax.ops.moments import LocalMoments, local_moments, masked_covariance, masked_mean, masked_variance
from cablejax.ops.neighbors import (
    KnnResult,
    RadiusCount,
    RadiusResult,
    SearchTree,
    build_tree,
    knn,
    knn_features,
    query,
    query_count,
    query_radius,
    radius_count,
    radius_search,
)
from cablejax.ops.normals import NormalResult, estimate_normals
from cablejax.ops.orient import orient_normals
from cablejax.ops.outliers import OutlierResult, median_outliers, radius_outliers, statistical_outliers
from cablejax.ops.raster import RasterTaps, cylinder_raster, raster_taps, sample_raster
from cablejax.ops.rigid import invert, kabsch, se3_exp, se3_log, transform
from cablejax.ops.sampling import Sample, ball_query, farthest_point_sampling
from cablejax.ops.sharded import query_sharded
from cablejax.ops.voxels import VoxelResult, voxel_downsample
from cablejax.ops.weighted_cylinder import WeightedCylinder, weighted_cylinder

__all__ = [
    "AttentionWeights",
    "CleanResult",
    "CylinderFrame",
    "EdgeList",
    "FilterResult",
    "KnnResult",
    "LocalMoments",
    "NormalResult",
    "OutlierResult",
    "RadiusCount",
    "RadiusResult",
    "RasterTaps",
    "Sample",
    "SearchTree",
    "SymmetricEigen",
    "Trial",
    "VoxelResult",
    "WeightedCylinder",
    "adaptive_filter",
    "ball_query",
    "build_tree",
    "channel_attention",
    "choose_alpha",
    "clean",
    "cylinder_frame",
    "cylinder_raster",
    "edge_conv",
    "edge_features",
    "edge_list",
    "estimate_normals",
    "farthest_point_sampling",
    "feature_graph",
    "invert",
    "kabsch",
    "knn",
    "knn_features",
    "knn_graph",
    "local_moments",
    "masked_covariance",
    "masked_mean",
    "masked_variance",
    "median_outliers",
    "neighbor_max",
    "neighbor_sum",
    "orient_normals",
    "pilot_places",
    "principal_frame",
    "query",
    "query_count",
    "query_radius",
    "query_sharded",
    "radius_count",
    "radius_graph",
    "radius_outliers",
    "radius_search",
    "raster_taps",
    "sample_raster",
    "se3_exp",
    "se3_log",
    "statistical_outliers",
    "symmetric_eigen",
    "transform",
    "usual_noise",
    "voxel_downsample",
    "weighted_cylinder",
    "width_trial",
]
