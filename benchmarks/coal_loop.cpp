// Coal in a plain C++ loop, driven from Python so that its passes alternate with ours in one run.
//
//   coal_loop DATA      loads hulls, ellipsoids and pairs once, prints "ready", then obeys lines of standard input:
//
//   pairs QUERY VARIANT CRITERION TYPE GUESS EARLY SELECTION ANSWERS
//     QUERY      hull-collide | hull-solver | ellipsoid-collide | ellipsoid-solver   boolean answers
//                hull-distance | hull-signed | hull-contact                          distance, witnesses, normal
//                ellipsoid-distance | ellipsoid-signed                               the same
//     VARIANT    0 default GJK, 1 Polyak, 2 Nesterov
//     CRITERION  0 default, 1 duality gap, 2 hybrid;   TYPE  0 relative, 1 absolute
//     GUESS      0 default, 1 cached (set to the offset of the bodies), 2 bounding volumes
//     EARLY      1 lets GJK stop as soon as the pair is proven apart
//     SELECTION  file of int64 pair numbers, or "-" for all;  ANSWERS  file to write, or "-"
//   crowd QUERY VARIANT CRITERION TYPE GUESS EARLY - ANSWERS
//     all overlapping pairs among the ellipsoids of the pairs' first bodies, by the dynamic AABB tree and GJK; building
//     the tree counts
//   step QUERY VARIANT CRITERION TYPE GUESS EARLY - ANSWERS
//     the same, with the tree there from an earlier time; giving it the new poses counts
//
// Each prints "wall_ns cpu_ns count". "...-solver" calls GJKSolver itself, without Coal's dispatch.
//
// Built with EIGEN_MAX_ALIGN_BYTES=16: the library of the wheel is built for plain x86-64, and types of both must agree.

#include <coal/broadphase/broadphase_dynamic_AABB_tree.h>
#include <coal/collision.h>
#include <coal/distance.h>
#include <coal/narrowphase/narrowphase.h>
#include <coal/shape/convex.h>
#include <coal/shape/geometric_shapes.h>

#include <cstdint>
#include <ctime>
#include <fstream>
#include <iostream>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

using Hull = coal::Convex<coal::Triangle>;
using coal::Matrix3s;
using coal::Transform3s;
using coal::Vec3s;

struct Data {
  std::vector<std::unique_ptr<Hull>> hulls;
  std::vector<std::unique_ptr<coal::Ellipsoid>> ellipsoids;
  std::vector<std::int64_t> a, b;                    // body numbers of each pair
  std::vector<Transform3s> pose_a, pose_b;           // of the hulls
  std::vector<Transform3s> ellipsoid_a, ellipsoid_b; // of their ellipsoids
};

template <typename T>
std::vector<T> read(std::istream& in, std::size_t count) {
  std::vector<T> values(count);
  in.read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(count * sizeof(T)));
  if (!in) throw std::runtime_error("coal_loop: the data file is too short");
  return values;
}

Matrix3s rows(const double* r) {
  Matrix3s R;
  R << r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8];
  return R;
}

Transform3s pose(const double* m) {  // of a row-major 4 x 4 matrix
  Matrix3s R;
  R << m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10];
  return Transform3s(R, Vec3s(m[3], m[7], m[11]));
}

Data load(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) throw std::runtime_error("coal_loop: cannot open " + path);
  const auto sizes = read<std::int64_t>(in, 4);  // bodies, vertices, triangles, pairs
  const std::size_t bodies = sizes[0], pairs = sizes[3];
  const auto vertex_start = read<std::int64_t>(in, bodies + 1);
  const auto triangle_start = read<std::int64_t>(in, bodies + 1);
  const auto vertices = read<double>(in, 3 * sizes[1]);
  const auto triangles = read<std::int64_t>(in, 3 * sizes[2]);
  const auto center = read<double>(in, 3 * bodies);
  const auto semi_axes = read<double>(in, 3 * bodies);
  const auto rotation = read<double>(in, 9 * bodies);

  Data data;
  std::vector<Transform3s> frame;
  for (std::size_t i = 0; i < bodies; ++i) {
    auto points = std::make_shared<std::vector<Vec3s>>();
    for (auto k = vertex_start[i]; k < vertex_start[i + 1]; ++k)
      points->emplace_back(vertices[3 * k], vertices[3 * k + 1], vertices[3 * k + 2]);
    auto faces = std::make_shared<std::vector<coal::Triangle>>();
    for (auto k = triangle_start[i]; k < triangle_start[i + 1]; ++k)
      faces->emplace_back(triangles[3 * k], triangles[3 * k + 1], triangles[3 * k + 2]);
    data.hulls.push_back(std::make_unique<Hull>(points, static_cast<unsigned>(points->size()), faces,
                                                static_cast<unsigned>(faces->size())));
    data.hulls.back()->computeLocalAABB();
    data.ellipsoids.push_back(
        std::make_unique<coal::Ellipsoid>(semi_axes[3 * i], semi_axes[3 * i + 1], semi_axes[3 * i + 2]));
    data.ellipsoids.back()->computeLocalAABB();
    frame.emplace_back(rows(&rotation[9 * i]), Vec3s(center[3 * i], center[3 * i + 1], center[3 * i + 2]));
  }

  data.a = read<std::int64_t>(in, pairs);
  data.b = read<std::int64_t>(in, pairs);
  const auto Ta = read<double>(in, 16 * pairs);
  const auto Tb = read<double>(in, 16 * pairs);
  for (std::size_t k = 0; k < pairs; ++k) {
    data.pose_a.push_back(pose(&Ta[16 * k]));
    data.pose_b.push_back(pose(&Tb[16 * k]));
    data.ellipsoid_a.push_back(data.pose_a[k] * frame[data.a[k]]);
    data.ellipsoid_b.push_back(data.pose_b[k] * frame[data.b[k]]);
  }
  return data;
}

double seconds(clockid_t clock) {
  timespec t;
  clock_gettime(clock, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

struct Stopwatch {
  double wall = seconds(CLOCK_MONOTONIC), cpu = seconds(CLOCK_PROCESS_CPUTIME_ID);
  void stop() {
    wall = seconds(CLOCK_MONOTONIC) - wall;
    cpu = seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu;
  }
};

// Answers go to their file before the times are told: the reader may come at once.
template <typename T>
void finish(const Stopwatch& watch, std::size_t count, const std::string& path, const std::vector<T>& values) {
  if (path != "-") {
    std::ofstream out(path, std::ios::binary);
    out.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(T)));
  }
  std::cout << static_cast<std::int64_t>(1e9 * watch.wall) << ' ' << static_cast<std::int64_t>(1e9 * watch.cpu) << ' '
            << count << std::endl;
}

struct Settings {
  int variant, criterion, type, guess, early;

  template <typename Request>
  void apply(Request& request) const {
    request.gjk_variant = static_cast<coal::GJKVariant>(variant);
    request.gjk_convergence_criterion = static_cast<coal::GJKConvergenceCriterion>(criterion);
    request.gjk_convergence_criterion_type = static_cast<coal::GJKConvergenceCriterionType>(type);
    request.gjk_initial_guess = static_cast<coal::GJKInitialGuess>(guess);
  }
};

// A first guess of the difference of the bodies, in the frame of the first.
Vec3s offset(const Transform3s& a, const Transform3s& b) {
  return a.getRotation().transpose() * (a.getTranslation() - b.getTranslation());
}

template <typename Shape>
void collide(const std::vector<std::unique_ptr<Shape>>& shapes, const Data& data, const std::vector<Transform3s>& Ta,
             const std::vector<Transform3s>& Tb, const std::vector<std::int64_t>& chosen, const Settings& settings,
             bool solver_only, const std::string& answers) {
  coal::CollisionRequest request;
  request.enable_contact = false;
  request.num_max_contacts = 1;
  if (settings.early) request.distance_upper_bound = 0;
  settings.apply(request);
  const bool cached = request.gjk_initial_guess == coal::GJKInitialGuess::CachedGuess;
  std::vector<std::int8_t> out(chosen.size());
  coal::CollisionResult result;
  coal::GJKSolver solver(request);
  Vec3s p, q, normal;

  Stopwatch watch;
  for (std::size_t m = 0; m < chosen.size(); ++m) {
    const auto k = chosen[m];
    const Shape &a = *shapes[data.a[k]], &b = *shapes[data.b[k]];
    if (solver_only) {
      solver.cached_guess = cached ? offset(Ta[k], Tb[k]) : Vec3s(1, 0, 0);
      out[m] = solver.shapeDistance(a, Ta[k], b, Tb[k], false, p, q, normal) <= request.collision_distance_threshold;
    } else {
      if (cached) request.cached_gjk_guess = offset(Ta[k], Tb[k]);
      result.clear();
      out[m] = coal::collide(&a, Ta[k], &b, Tb[k], request, result) > 0;
    }
  }
  watch.stop();
  finish(watch, chosen.size(), answers, out);
}

struct Nearest {
  double distance, witnesses[6], normal[3];
};

void store(Nearest& to, double distance, const Vec3s& p, const Vec3s& q, const Vec3s& normal) {
  to.distance = distance;
  for (int c = 0; c < 3; ++c) {
    to.witnesses[c] = p[c];
    to.witnesses[3 + c] = q[c];
    to.normal[c] = normal[c];
  }
}

template <typename Shape>
void distances(const std::vector<std::unique_ptr<Shape>>& shapes, const Data& data, const std::vector<Transform3s>& Ta,
               const std::vector<Transform3s>& Tb, const std::vector<std::int64_t>& chosen, const Settings& settings,
               bool is_signed, const std::string& answers) {
  coal::DistanceRequest request;
  request.enable_signed_distance = is_signed;
  settings.apply(request);
  const bool cached = request.gjk_initial_guess == coal::GJKInitialGuess::CachedGuess;
  std::vector<Nearest> out(chosen.size());
  coal::DistanceResult result;

  Stopwatch watch;
  for (std::size_t m = 0; m < chosen.size(); ++m) {
    const auto k = chosen[m];
    if (cached) request.cached_gjk_guess = offset(Ta[k], Tb[k]);
    result.clear();
    const double d = coal::distance(shapes[data.a[k]].get(), Ta[k], shapes[data.b[k]].get(), Tb[k], request, result);
    store(out[m], d, result.nearest_points[0], result.nearest_points[1], result.normal);
  }
  watch.stop();
  finish(watch, chosen.size(), answers, out);
}

void contacts(const Data& data, const std::vector<std::int64_t>& chosen, const Settings& settings,
              const std::string& answers) {
  coal::CollisionRequest request;
  request.enable_contact = true;
  request.num_max_contacts = 1;
  settings.apply(request);
  if (settings.early) request.distance_upper_bound = 0;
  const bool cached = request.gjk_initial_guess == coal::GJKInitialGuess::CachedGuess;
  std::vector<Nearest> out(chosen.size());
  coal::CollisionResult result;

  Stopwatch watch;
  for (std::size_t m = 0; m < chosen.size(); ++m) {
    const auto k = chosen[m];
    if (cached) request.cached_gjk_guess = offset(data.pose_a[k], data.pose_b[k]);
    result.clear();
    if (coal::collide(data.hulls[data.a[k]].get(), data.pose_a[k], data.hulls[data.b[k]].get(), data.pose_b[k],
                      request, result)) {
      const coal::Contact& contact = result.getContact(0);
      store(out[m], contact.penetration_depth, contact.nearest_points[0], contact.nearest_points[1], contact.normal);
    } else {
      out[m].distance = result.distance_lower_bound;
    }
  }
  watch.stop();
  finish(watch, chosen.size(), answers, out);
}

// Collects the overlapping pairs that the broad phase hands on.
struct Overlaps : coal::CollisionCallBackBase {
  coal::CollisionRequest request;
  coal::CollisionResult result;
  std::vector<std::int64_t> found;

  bool collide(coal::CollisionObject* a, coal::CollisionObject* b) override {
    result.clear();
    if (coal::collide(a->collisionGeometryPtr(), a->getTransform(), b->collisionGeometryPtr(), b->getTransform(),
                      request, result)) {
      found.push_back(static_cast<std::int64_t>(reinterpret_cast<std::intptr_t>(a->getUserData())));
      found.push_back(static_cast<std::int64_t>(reinterpret_cast<std::intptr_t>(b->getUserData())));
    }
    return false;
  }
};

// Every pair's first body, where the pair puts it, is one ellipsoid of the crowd.
struct Crowd {
  std::vector<std::unique_ptr<coal::CollisionObject>> objects;
  coal::DynamicAABBTreeCollisionManager manager;

  Crowd(const Data& data, const std::vector<std::shared_ptr<coal::Ellipsoid>>& shapes) {
    std::vector<coal::CollisionObject*> pointers;
    for (std::size_t k = 0; k < shapes.size(); ++k) {
      objects.push_back(std::make_unique<coal::CollisionObject>(shapes[k], data.ellipsoid_a[k], false));
      objects.back()->setUserData(reinterpret_cast<void*>(static_cast<std::intptr_t>(k)));
      objects.back()->computeAABB();
      pointers.push_back(objects.back().get());
    }
    manager.registerObjects(pointers);
    manager.setup();
  }

  void move(const Data& data) {
    for (std::size_t k = 0; k < objects.size(); ++k) {
      objects[k]->setTransform(data.ellipsoid_a[k]);
      objects[k]->computeAABB();
    }
    manager.update();
  }
};

void crowd(const Data& data, const Settings& settings, const std::string& answers, bool built) {
  std::vector<std::shared_ptr<coal::Ellipsoid>> shapes;
  for (std::size_t k = 0; k < data.a.size(); ++k)
    shapes.push_back(std::make_shared<coal::Ellipsoid>(*data.ellipsoids[data.a[k]]));
  Overlaps overlaps;
  overlaps.request.enable_contact = false;
  overlaps.request.distance_upper_bound = 0;
  settings.apply(overlaps.request);
  std::unique_ptr<Crowd> crowd;
  if (built) crowd = std::make_unique<Crowd>(data, shapes);

  Stopwatch watch;
  if (built)
    crowd->move(data);
  else
    crowd = std::make_unique<Crowd>(data, shapes);
  crowd->manager.collide(&overlaps);
  watch.stop();
  finish(watch, shapes.size(), answers, overlaps.found);
}

void obey(const Data& data, const std::string& line) {
  std::istringstream words(line);
  std::string task, query, selection, answers;
  Settings settings{};
  words >> task >> query >> settings.variant >> settings.criterion >> settings.type >> settings.guess >>
      settings.early >> selection >> answers;
  if (!words) throw std::runtime_error("coal_loop: cannot read the line: " + line);
  if (task == "crowd" || task == "step") return crowd(data, settings, answers, task == "step");

  std::vector<std::int64_t> chosen;
  if (selection == "-") {
    for (std::size_t k = 0; k < data.a.size(); ++k) chosen.push_back(static_cast<std::int64_t>(k));
  } else {
    std::ifstream in(selection, std::ios::binary | std::ios::ate);
    const auto count = static_cast<std::size_t>(in.tellg()) / sizeof(std::int64_t);
    in.seekg(0);
    chosen = read<std::int64_t>(in, count);
  }
  if (query == "hull-collide" || query == "hull-solver")
    collide(data.hulls, data, data.pose_a, data.pose_b, chosen, settings, query == "hull-solver", answers);
  else if (query == "ellipsoid-collide" || query == "ellipsoid-solver")
    collide(data.ellipsoids, data, data.ellipsoid_a, data.ellipsoid_b, chosen, settings, query == "ellipsoid-solver",
            answers);
  else if (query == "hull-distance" || query == "hull-signed")
    distances(data.hulls, data, data.pose_a, data.pose_b, chosen, settings, query == "hull-signed", answers);
  else if (query == "ellipsoid-distance" || query == "ellipsoid-signed")
    distances(data.ellipsoids, data, data.ellipsoid_a, data.ellipsoid_b, chosen, settings, query == "ellipsoid-signed",
              answers);
  else if (query == "hull-contact")
    contacts(data, chosen, settings, answers);
  else
    throw std::runtime_error("coal_loop: unknown query " + query);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    if (argc != 2) throw std::runtime_error("coal_loop: expected one argument, the data file");
    const Data data = load(argv[1]);
    std::cout << "ready" << std::endl;
    for (std::string line; std::getline(std::cin, line);) obey(data, line);
  } catch (const std::exception& error) {
    std::cerr << error.what() << std::endl;
    return 1;
  }
  return 0;
}
