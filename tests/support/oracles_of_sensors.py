"""What other programs make of packets and frames: run by a Python that has them, which need not be Camber's.

PYTHON oracles_of_sensors.py velodyne PCAP          x y z of all points, float32, as .npy to standard output
PYTHON oracles_of_sensors.py ouster PCAP JSON       the same, and time stamps of columns, in one .npz
PYTHON oracles_of_sensors.py can LOG DBC            message, signal, value of every frame, a line each
"""

import io
import sys
import warnings


def velodyne(pcap: str) -> None:
    import numpy as np
    import velodyne_decoder as vd

    decoder = vd.ScanDecoder(vd.Config())
    packets = [vd.VelodynePacket(stamp, data) for stamp, data in vd.util.iter_pcap(pcap)]
    scan = decoder.decode(packets, as_pcl_structs=True)[1]
    np.save(buffer := io.BytesIO(), np.stack([scan[axis] for axis in "xyz"], axis=1))
    sys.stdout.buffer.write(buffer.getvalue())


def ouster(pcap: str, metadata: str) -> None:
    import dpkt
    import numpy as np
    from ouster.sdk import core

    with open(metadata) as file:
        info = core.SensorInfo(file.read())
    form = core.PacketFormat.from_info(info)
    points, stamps, whole = [], [], {}
    to_points = core.XYZLut(info, use_extrinsics=False)
    range_mm = np.zeros((info.h, info.w), np.uint32)
    with open(pcap, "rb") as file:
        for _, frame in dpkt.pcap.Reader(file):
            ip = dpkt.ethernet.Ethernet(frame).data
            whole.setdefault(ip.id, b"")
            whole[ip.id] += bytes(ip.data)
            if ip.mf:
                continue
            packet = core.LidarPacket(form)
            packet.buf[:] = np.frombuffer(whole.pop(ip.id)[8:], np.uint8)
            column = form.packet_header(core.ColHeader.MEASUREMENT_ID, packet.buf)
            stamps.append(form.packet_header(core.ColHeader.TIMESTAMP, packet.buf))
            range_mm[:, column] = form.packet_field("RANGE", packet.buf)
            if column[-1] == info.w - 1:
                in_order = np.swapaxes(to_points(range_mm), 0, 1).reshape(-1, 3)
                points.append(in_order[range_mm.T.reshape(-1) != 0])
                range_mm[:] = 0
    np.savez(buffer := io.BytesIO(), points=np.concatenate(points), stamps=np.concatenate(stamps))
    sys.stdout.buffer.write(buffer.getvalue())


def can(log: str, dbc: str) -> None:
    import cantools

    database = cantools.database.load_file(dbc)
    with open(log) as file:
        for line in file:
            _, _, frame = line.split()
            identifier, _, data = frame.partition("#")
            message = database.get_message_by_frame_id(int(identifier, 16))
            for signal, value in message.decode(bytes.fromhex(data), scaling=True).items():
                print(message.name, signal, repr(float(value)))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    {"velodyne": velodyne, "ouster": ouster, "can": can}[sys.argv[1]](*sys.argv[2:])
