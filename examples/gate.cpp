// Let targets of joints through for as long as each is proven, and a brake behind it; then brake. The robot is simulated
// and follows its commands: python examples/save_cell.py cell.lwn, then ./gate cell.lwn

#include <loewner.hpp>

#include <algorithm>
#include <iostream>

using Vector = std::vector<double>;

// The brake that was proven last: the gate's own memory changes with its next check.
struct Brake {
    Vector times, positions, velocities;

    void keep(const loewner_gate_answer &found, std::size_t dof)
    {
        times.assign(found.times, found.times + found.brake_count);
        positions.assign(found.positions, found.positions + found.brake_count * dof);
        velocities.assign(found.velocities, found.velocities + found.brake_count * dof);
    }

    // The position of a joint so many seconds after the brake began: on the cubic between two positions and velocities.
    double position(double time, std::size_t joint, std::size_t dof) const
    {
        const std::size_t next = std::upper_bound(times.begin(), times.end(), time) - times.begin();
        if (next == times.size())
            return positions[(next - 1) * dof + joint];
        const std::size_t a = (next - 1) * dof + joint, b = a + dof;
        const double T = times[next] - times[next - 1], s = (time - times[next - 1]) / T;
        return positions[a] + s * s * (3 - 2 * s) * (positions[b] - positions[a]) +
               T * s * (1 - s) * ((1 - s) * velocities[a] - s * velocities[b]);
    }
};

int main(int count, char **arguments)
try {
    const loewner::Checker checker(count > 1 ? arguments[1] : "cell.lwn");
    loewner::Workspace workspace;
    const std::size_t dof = checker.dof();
    const double cycle = 0.01, strongest = 4.0;
    const Vector acceleration(dof, strongest);
    // Between two commands the robot is on a line, and the brake on a curve, which is at most this far from it.
    const Vector error(dof, strongest * cycle * cycle / 8);
    loewner_gate_options options = {};
    options.acceleration = acceleration.data(); // velocities are those of the robot's description
    options.joint_error = error.data();
    loewner::Gate gate(checker, options, 1);

    Vector q = {0, -0.78, 0, -2.36, 0, 1.57, 0.78, 0.02}, dq(dof, 0.0), target(dof);
    Brake brake;
    double braking = 0.0; // seconds since it began
    std::size_t passed = 0;
    const char *const reasons[] = {"nothing", "contact", "brake", "may be hit", "limits", "budget"};
    for (int tick = 0; tick < 1000; tick++) {
        target = q;
        target[1] += std::min(dq[1] + 2.0 * cycle, 0.6) * cycle; // faster and faster, down towards a box
        const loewner_gate_answer found = gate.check(q, dq, target, cycle, tick * cycle);
        const bool is_proven = found.steps == 1;
        if (is_proven) {
            brake.keep(found, dof);
            braking = 0.0;
            passed++;
        } else if (passed == 0 || braking >= brake.times.back()) {
            std::cout << passed << " targets passed, then the robot braked (" << reasons[found.reason];
            for (const std::int32_t body : found.bodies)
                if (body >= 0)
                    std::cout << ", " << checker.body_name(body);
            std::cout << ") and stands at " << q[1] << "\n";
            break;
        } else {
            braking += cycle;
            for (std::size_t c = 0; c < dof; c++)
                target[c] = brake.position(braking, c, dof);
        }
        for (std::size_t c = 0; c < dof; c++)
            dq[c] = (target[c] - q[c]) / cycle;
        q = target; // command the robot, which is here
        if (checker.collide(workspace, q) != loewner::Verdict::Free)
            std::cout << "a collision\n";
    }
} catch (const loewner::Error &error) {
    std::cerr << error.what() << '\n';
    return 1;
}
