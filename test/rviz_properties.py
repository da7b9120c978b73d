"""
Properties of RViz's displays, views and panels in ROS 2 Jazzy, as far as layouts here use them.

Read from the source of ros2/rviz, branch jazzy (591594e): names that its classes give to their
properties and load from a layout. RViz ignores other names without a word.
"""


# A type is the type of a value, a tuple its options. A dict is a group: its properties by name,
# and the value of the group itself as `Value`.

VECTOR = {'X': float, 'Y': float, 'Z': float}
TOPIC = {
    'Value': str,
    'Depth': int,
    'History Policy': ('System Default', 'Keep Last', 'Keep All'),
    'Reliability Policy': ('System Default', 'Reliable', 'Best Effort'),
    'Durability Policy': ('System Default', 'Transient Local', 'Volatile'),
    'Filter size': int,
}
DISPLAY = {'Class': str, 'Name': str, 'Enabled': bool, 'Value': bool}

DISPLAYS = {
    'rviz_default_plugins/Grid': {
        'Reference Frame': str,
        'Plane Cell Count': int,
        'Normal Cell Count': int,
        'Cell Size': float,
        'Line Style': ('Lines', 'Billboards'),
        'Color': str,
        'Alpha': float,
        'Plane': ('XY', 'XZ', 'YZ'),
        'Offset': VECTOR,
    },
    'rviz_default_plugins/TF': {
        'Show Names': bool,
        'Show Axes': bool,
        'Show Arrows': bool,
        'Marker Scale': float,
        'Update Interval': float,
        'Frame Timeout': float,
        'Frames': {'All Enabled': bool, ...: {'Value': bool}},
    },
    'rviz_default_plugins/RobotModel': {
        'Visual Enabled': bool,
        'Collision Enabled': bool,
        'Update Interval': float,
        'Alpha': float,
        'Description Source': ('Topic', 'File'),
        'Description File': str,
        'Description Topic': TOPIC,
        'TF Prefix': str,
    },
    'rviz_default_plugins/Odometry': {
        'Topic': TOPIC,
        'Position Tolerance': float,
        'Angle Tolerance': float,
        'Keep': int,
        'Shape': {'Value': ('Arrow', 'Axes'), 'Axes Length': float, 'Axes Radius': float},
        'Covariance': {'Value': bool},
    },
    'rviz_default_plugins/PointCloud2': {
        'Topic': TOPIC,
        'Selectable': bool,
        'Style': ('Points', 'Squares', 'Flat Squares', 'Spheres', 'Boxes', 'Tiles'),
        'Size (m)': float,
        'Size (Pixels)': float,
        'Alpha': float,
        'Decay Time': float,
        'Position Transformer': ('XYZ', ''),
        'Color Transformer': ('AxisColor', 'FlatColor', 'Intensity', 'RGB8', 'RGBF32', ''),
        'Axis': ('X', 'Y', 'Z'),
        'Autocompute Value Bounds': {'Value': bool, 'Min Value': float, 'Max Value': float},
        'Use Fixed Frame': bool,
    },
    'rviz_default_plugins/Image': {
        'Topic': TOPIC,
        'Normalize Range': bool,
        'Min Value': float,
        'Max Value': float,
        'Median window': int,
    },
}
TOOLS = {
    f'rviz_default_plugins/{name}'
    for name in ('MoveCamera', 'Select', 'Measure', 'FocusCamera', 'Interact', 'PublishPoint')
}
VIEWS = {
    'rviz_default_plugins/Orbit': {
        'Class': str,
        'Name': str,
        'Target Frame': str,
        'Near Clip Distance': float,
        'Distance': float,
        'Yaw': float,
        'Pitch': float,
        'Focal Point': VECTOR,
    }
}
PANELS = {
    'rviz_common/Displays': {'Property Tree Widget': {'Splitter Ratio': float}},
    'rviz_common/Time': {'SyncMode': int, 'SyncSource': str},
}
GLOBAL = {'Background Color': str, 'Fixed Frame': str, 'Frame Rate': int}


def problems(kind, value, where):
    """Return what RViz would ignore in a part of a layout, a line each."""
    if isinstance(kind, dict):
        if not isinstance(value, dict):
            return [f'{where}: must be a group, got {value!r}']
        found = []
        for name, part in value.items():
            if name in kind or ... in kind:
                found += problems(kind.get(name, kind.get(...)), part, f'{where}: {name}')
            else:
                found.append(f'{where}: there is no property {name}')
        return found
    if isinstance(kind, tuple):
        return [] if value in kind else [f'{where}: must be one of {kind}, got {value!r}']
    numbers = (int, float) if kind is float else (kind,)
    right = isinstance(value, numbers) and (kind is bool or not isinstance(value, bool))
    return [] if right else [f'{where}: must be {kind.__name__}, got {value!r}']
