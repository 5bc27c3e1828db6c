// What stands in the scene beside surfaces and nodes: places where the error was measured, walls, probes, the box, the place
// that was chosen.
import { BoxGeometry, BufferAttribute, BufferGeometry, Color, EdgesGeometry, Group, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, OctahedronGeometry, SphereGeometry, SRGBColorSpace } from 'three';
import { heat, shareOf } from './scales.js';

const MOST_WALLS = 20_000;
const EDGES = [ 0, 1, 2, 3, 4, 5, 6, 7, 0, 2, 1, 3, 4, 6, 5, 7, 0, 4, 1, 5, 2, 6, 3, 7 ];
const lines = ( positions, color ) => {

	const geometry = new BufferGeometry();
	geometry.setAttribute( 'position', new BufferAttribute( positions, 3 ) );
	return new LineSegments( geometry, new LineBasicMaterial( { color, toneMapped: false } ) );

};

/** Boxes, six numbers each: lower corner, upper corner. */
export function boxes( corners, origin, color ) {

	const count = Math.min( MOST_WALLS, corners.length / 6 );
	const positions = new Float32Array( 72 * count );
	for ( let box = 0; box < count; box ++ ) EDGES.forEach( ( corner, k ) => {

		for ( let c = 0; c < 3; c ++ ) positions[ 72 * box + 3 * k + c ] = corners[ 6 * box + ( corner >> c & 1 ) * 3 + c ] - origin[ c ];

	} );
	return lines( positions, color );

}

/** Places where the error between nodes was measured, in the colours of their errors. */
export function seenPlaces( seen, origin, radius, scale ) {

	const mesh = new InstancedMesh( new SphereGeometry( radius, 16, 8 ), new MeshBasicMaterial( { toneMapped: false } ), seen.length );
	seen.forEach( ( { position, error }, k ) => {

		mesh.setMatrixAt( k, new Matrix4().makeTranslation( ...position.map( ( x, c ) => x - origin[ c ] ) ) );
		mesh.setColorAt( k, new Color().setRGB( ...heat( shareOf( scale, error ) ).map( ( byte ) => byte / 255 ), SRGBColorSpace ) );

	} );
	mesh.frustumCulled = false;
	return mesh;

}

/** Where probes stand; seen through everything. */
export function probes( all, origin, radius ) {

	const group = new Group();
	for ( const { position } of all.filter( ( probe ) => probe.position ) ) {

		const mark = new Mesh( new OctahedronGeometry( radius ), new MeshBasicMaterial( { color: 0x19a7e0, depthTest: false, toneMapped: false } ) );
		mark.renderOrder = 1;
		mark.position.set( ...position.map( ( x, c ) => x - origin[ c ] ) );
		mark.add( new LineSegments( new EdgesGeometry( mark.geometry ), new LineBasicMaterial( { color: 0xffffff, depthTest: false } ) ) );
		group.add( mark );

	}

	return group;

}

/** A frame around the place that was chosen; seen through everything. */
export function chosenMark( radius ) {

	const mark = new LineSegments( new EdgesGeometry( new BoxGeometry( 2 * radius, 2 * radius, 2 * radius ) ), new LineBasicMaterial( { color: 0x00e5ff, depthTest: false, toneMapped: false } ) );
	mark.renderOrder = 1;
	mark.visible = false;
	return mark;

}
