"""Networks that ADGCNN is compared with: three on a depth image of the cloud, four on its points."""

from cablejax.nets.baselines.alexnet import AlexNet
from cablejax.nets.baselines.dgcnn import DGCNN
from cablejax.nets.baselines.pointnet import PointNet
from cablejax.nets.baselines.pointnet2 import PointNet2
from cablejax.nets.baselines.pointnext import PointNeXt
from cablejax.nets.baselines.resnet import ResNet50
from cablejax.nets.baselines.vgg import VGG16

__all__ = ["DGCNN", "VGG16", "AlexNet", "PointNeXt", "PointNet", "PointNet2", "ResNet50"]
