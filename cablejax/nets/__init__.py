"""Networks in Flax NNX: ADGCNN and what it is compared with tell a cable's size, another labels a scan's points by part."""

from cablejax.nets.adgcnn import ADGCNN
from cablejax.nets.adgcnn_fit import ADGCNNFit, FitEstimate
from cablejax.nets.aedgeconv import AEdgeConv, ChannelAttention
from cablejax.nets.baselines import DGCNN, VGG16, AlexNet, PointNet, PointNet2, ResNet50
from cablejax.nets.depth import depth_image
from cablejax.nets.diameter import SizeEstimate
from cablejax.nets.enhancement import FeatureEnhancement
from cablejax.nets.fusion import FeatureFusion
from cablejax.nets.input_channels import PosedClouds, pose_clouds
from cablejax.nets.labelling import PartLabels, label_parts
from cablejax.nets.models import MODELS, build_model, count_parameters
from cablejax.nets.norm import BatchNorm
from cablejax.nets.part_network import PartNetwork
from cablejax.nets.pretrained import Calibrated, Pretrained, WeightsError, load_pretrained, pretrained_names

__all__ = [
    "ADGCNN",
    "DGCNN",
    "MODELS",
    "VGG16",
    "ADGCNNFit",
    "AEdgeConv",
    "AlexNet",
    "BatchNorm",
    "Calibrated",
    "ChannelAttention",
    "FeatureEnhancement",
    "FeatureFusion",
    "FitEstimate",
    "PartLabels",
    "PartNetwork",
    "PointNet",
    "PointNet2",
    "PosedClouds",
    "Pretrained",
    "ResNet50",
    "SizeEstimate",
    "WeightsError",
    "build_model",
    "count_parameters",
    "depth_image",
    "label_parts",
    "load_pretrained",
    "pose_clouds",
    "pretrained_names",
]
