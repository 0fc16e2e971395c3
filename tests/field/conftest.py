import pytest

from torchdt.field import Environment, HalfSpace, Layer


@pytest.fixture(scope="session")
def swellex() -> Environment:
    """The SWellEx-96 waveguide: published bottom, a coarse version of its sound-speed profile."""
    depths = [0, 3.7, 6.2, 8.7, 10.1, 11, 12, 12.8, 14.3, 15.3, 16.8, 19.8, 22.2, 24.5, 29.7, 32.9, 40.5]
    depths += [48.7, 74.7, 87.3, 99.1, 114.2, 123.7, 133.9, 162.3, 168.2, 193.1, 216.5]
    speeds = [1521.9, 1521.7, 1520.4, 1519.6, 1518.8, 1517.7, 1512.3, 1508.8, 1505.1, 1503.2, 1501.4, 1499.8]
    speeds += [1498.4, 1496.7, 1495.2, 1493.7, 1492.4, 1491.9, 1489.7, 1489.6, 1488.4, 1487.7, 1488.1, 1488.9]
    speeds += [1489.0, 1488.5, 1488.3, 1488.3]
    return Environment(
        profile=tuple(zip(depths, speeds, strict=True)),
        layers=(
            Layer(bottom=240.0, speed_top=1572.368, speed_bottom=1593.016, density=1.76, attenuation=0.20),
            Layer(bottom=1040.0, speed_top=1881.0, speed_bottom=3245.8, density=2.06, attenuation=0.06),
        ),
        halfspace=HalfSpace(speed=5200.0, density=2.66, attenuation=0.02),
    )


@pytest.fixture(scope="session")
def tones() -> tuple[float, ...]:
    return (49.0, 79.0, 112.0, 148.0, 201.0, 283.0, 388.0)


@pytest.fixture(scope="session")
def sensors() -> tuple[float, ...]:
    """The 21 depths of the vertical array, m."""
    upper = (94.125, 99.755, 105.38, 111.0, 116.62, 122.25, 127.88, 139.12, 144.74, 150.38, 155.99)
    return (*upper, 161.62, 167.26, 172.88, 178.49, 184.12, 189.76, 195.38, 200.99, 206.62, 212.25)
