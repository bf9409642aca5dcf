"""Packaging of momrec: one ament_python package that plain pip installs as well."""

from pathlib import Path

from setuptools import Extension, setup

PACKAGE = "momrec_ros"
SHARED_FOLDERS = ("bags", "config", "launch", "meshes", "models", "rviz")


def shared_files() -> list[tuple[str, list[str]]]:
    """Return what is installed under ``share/momrec_ros``, folder by folder."""
    installed = [
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ]
    for top in SHARED_FOLDERS:
        folders = [path for path in [Path(top), *sorted(Path(top).rglob("*"))] if path.is_dir()]
        for folder in folders:
            files = sorted(str(path) for path in folder.iterdir() if path.is_file())
            if files:
                installed.append((f"share/{PACKAGE}/{folder.as_posix()}", files))
    return installed


ROS = [
    "ros-jazzy-rclpy[fastrtps]>=7.1.6",
    "ros-jazzy-common-interfaces>=5.3.6",
]
TEST = [
    "colcon-common-extensions>=0.3.0",
    "contourpy>=1.2",
    "hypothesis>=6.100",
    "import-linter>=2.0",
    "mcap-ros2-support>=0.5",
    "mypy>=1.13",
    "pytest>=8.0",
    "pytest-xdist>=3.5",
    "rosbags>=0.11",
    "ruff>=0.9",
    "setuptools>=70,<80",
]
BENCH = [
    "open3d>=0.19",
    "scikit-image>=0.24",
]

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Silhouettes with camera poses to closed meshes, principal frames and class labels",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer="momrec maintainers",
    maintainer_email="maintainers@momrec.example.org",
    packages=["momrec_core", "momrec_ros"],
    package_data={"momrec_core": ["py.typed", "*.pyi"], "momrec_ros": ["py.typed"]},
    ext_modules=[
        Extension(
            f"momrec_core.{name}",
            [f"momrec_core/{name}.c"],
            depends=sorted(map(str, Path("momrec_core").glob("_*.h"))),
            extra_compile_args=["-O3", "-fno-math-errno"],  # square roots of several at once
        )
        for name in sorted(path.stem for path in Path("momrec_core").glob("_*.c"))
    ],
    data_files=shared_files(),
    python_requires=">=3.11",
    install_requires=[
        "lz4>=4.0",
        "manifold3d>=3.0",
        "matplotlib>=3.8",
        "mcap>=1.2",
        "numpy>=1.26",
        "pillow>=10.0",
        "pyyaml>=6.0",
        "rich>=13.0",
        "scikit-learn>=1.5",
        "scipy>=1.11",
        "shapely>=2.1",
        "trimesh>=4.4",
        "typer>=0.12",
        "zstandard>=0.20",
    ],
    extras_require={"ros": ROS, "test": TEST, "bench": BENCH},
    entry_points={
        "console_scripts": [
            "momrec = momrec_ros.cli:main",
            "recognizer = momrec_ros.recognizer:main",
        ],
    },
    zip_safe=False,
)
