"""
Publish clean depth as another simulator does: with rclpy only, without this package.

``python test/plain_publisher.py NAMESPACE`` publishes a wall as soon as there is a subscriber.
"""

import argparse
from array import array
import json
import time

import rclpy
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from sensor_msgs.msg import CameraInfo, Image


def main():
    """Publish, then print the number of images and the slowest publish call, as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('namespace')
    parser.add_argument('--size', default='224x172', help='of the images, pixels')
    parser.add_argument('--rate', type=float, default=30.0, help='Hz')
    parser.add_argument('--count', type=int, default=60, help='images')
    parser.add_argument('--value', type=float, default=1.5, help='of every pixel, 32FC1')
    parser.add_argument('--best-effort', action='store_true', help='sensor-data QoS')
    parser.add_argument(
        '--latched-info',
        action='store_true',
        help='publish camera_info once, transient local, at the start',
    )
    options = parser.parse_args()
    rclpy.init(args=[])
    node = rclpy.create_node('plain_publisher', namespace=options.namespace)
    quality = qos_profile_sensor_data if options.best_effort else 10
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    images = node.create_publisher(Image, 'clean/depth_image', quality)
    infos = node.create_publisher(
        CameraInfo, 'clean/camera_info', latched if options.latched_info else quality
    )
    image, info = wall(options.size, options.value)
    if options.latched_info:
        infos.publish(info)
    print('ready', flush=True)
    while not (images.get_subscription_count() and infos.get_subscription_count()):
        time.sleep(0.02)
    time.sleep(1.0)  # The subscriber may change the quality of service that it requests.
    slowest, start = 0.0, time.perf_counter()
    for index in range(options.count):
        time.sleep(max(0.0, start + index / options.rate - time.perf_counter()))
        stamp = 10**12 + round(index * 1e9 / options.rate)
        for message in (info, image):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        if not options.latched_info:
            infos.publish(info)
        before = time.perf_counter()
        images.publish(image)
        slowest = max(slowest, time.perf_counter() - before)
    seconds = time.perf_counter() - start
    if not options.best_effort:
        images.wait_for_all_acked(Duration(seconds=5))
    print(json.dumps({'sent': options.count, 'seconds': seconds, 'slowest': slowest}), flush=True)
    rclpy.shutdown()


def wall(size, value):
    """Return an image of one value and a camera 60 degrees wide."""
    width, height = (int(side) for side in size.split('x'))
    image = Image(width=width, height=height, encoding='32FC1', step=4 * width)
    image.data = array('B', array('f', [value]).tobytes() * (width * height))
    f = 0.866 * width
    info = CameraInfo(
        width=width,
        height=height,
        distortion_model='plumb_bob',
        d=[0.0] * 5,
        k=[f, 0.0, (width - 1) / 2, 0.0, f, (height - 1) / 2, 0.0, 0.0, 1.0],
    )
    for message in (image, info):
        message.header.frame_id = 'simulator_optical_frame'
    return image, info


if __name__ == '__main__':
    main()
