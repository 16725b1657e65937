// Grasp a part with the hand of a saved robot, plan, and put it down: python examples/save_cell.py cell.lwn, then
// ./grasp cell.lwn parts.lwn

#include <loewner.hpp>

#include <iostream>

int main(int count, char **arguments)
try {
    loewner::Checker checker(count > 1 ? arguments[1] : "cell.lwn");
    const loewner::Bodies parts(count > 2 ? arguments[2] : "parts.lwn");
    loewner::Workspace workspace;

    const loewner::Pose on_table = {1, 0, 0, 0.5, 0, 1, 0, -0.3, 0, 0, 1, 0.1, 0, 0, 0, 1};
    const std::int32_t part = checker.add("part", parts, 0, on_table);

    // The fingers touch what the hand holds.
    const loewner::Pose in_hand = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.15, 0, 0, 0, 1};
    checker.attach(part, checker.link("panda_hand"), in_hand,
                   {checker.link("panda_leftfinger"), checker.link("panda_rightfinger")});

    const std::vector<double> start = {0, -0.78, 0, -2.36, 0, 1.57, 0.78, 0.02};
    const std::vector<double> goal = {0.9, -0.4, 0.2, -2.0, 0.1, 1.7, 0.5, 0.02};
    const std::vector<double> path = checker.plan(workspace, start, goal);
    std::cout << "carried along " << path.size() / checker.dof() << " configurations\n";

    checker.detach(part, on_table);
} catch (const loewner::Error &error) {
    std::cerr << error.what() << '\n';
    return 1;
}
